"""Figures of campaigns."""

from brink.plots.campaign import (
    FIGURES,
    figure_dbs,
    figure_fitness,
    figure_parameters,
    write_campaign_figures,
)
from brink.plots.embedding import figure_embedding
from brink.plots.inputs import CampaignFigures

__all__ = [
    "FIGURES",
    "CampaignFigures",
    "figure_dbs",
    "figure_embedding",
    "figure_fitness",
    "figure_parameters",
    "write_campaign_figures",
]
