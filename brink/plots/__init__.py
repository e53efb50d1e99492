"""Figures of campaigns."""

from brink.plots.dbs import figure_dbs
from brink.plots.embedding import figure_embedding
from brink.plots.fitness import figure_fitness
from brink.plots.inputs import CampaignFigures
from brink.plots.parameters import figure_parameters
from brink.plots.write import FIGURES, write_campaign_figures

__all__ = [
    "FIGURES",
    "CampaignFigures",
    "figure_dbs",
    "figure_embedding",
    "figure_fitness",
    "figure_parameters",
    "write_campaign_figures",
]
