"""Figures of campaigns."""

from brink.server.plots.dbs import figure_dbs
from brink.server.plots.embedding import figure_embedding
from brink.server.plots.fitness import figure_fitness
from brink.server.plots.inputs import CampaignFigures
from brink.server.plots.parameters import figure_parameters
from brink.server.plots.write import FIGURES, write_campaign_figures

__all__ = [
    "FIGURES",
    "CampaignFigures",
    "figure_dbs",
    "figure_embedding",
    "figure_fitness",
    "figure_parameters",
    "write_campaign_figures",
]
