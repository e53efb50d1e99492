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
from brink.plots.pair import PairFigure, figure_pair

__all__ = [
    "FIGURES",
    "CampaignFigures",
    "PairFigure",
    "figure_dbs",
    "figure_embedding",
    "figure_fitness",
    "figure_pair",
    "figure_parameters",
    "write_campaign_figures",
]
