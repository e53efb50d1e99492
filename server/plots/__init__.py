"""Figures of campaigns."""

from server.plots.dbs import figure_dbs
from server.plots.embedding import figure_embedding
from server.plots.fitness import figure_fitness
from server.plots.inputs import CampaignFigures
from server.plots.parameters import figure_parameters
from server.plots.write import FIGURES, write_campaign_figures

__all__ = [
    "FIGURES",
    "CampaignFigures",
    "figure_dbs",
    "figure_embedding",
    "figure_fitness",
    "figure_parameters",
    "write_campaign_figures",
]
