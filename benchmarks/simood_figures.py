"""Figures of the SiMOOD criteria: which techniques are hazardous together (A3, A4), and Fig. 4 of the paper (A6)."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from benchmarks.simood_places import CONFIRMATION_PLACES, NamedChain, words_of
from brink.search.analysis.combinations import HAZARDOUS, SAFE

_BLUE: Final = "#0072b2"
_ORANGE: Final = "#d55e00"
_PLACES: Final = len(CONFIRMATION_PLACES)


def is_only_together(chain: NamedChain, share: float, parts: Mapping[NamedChain, float]) -> bool:
    """Return whether a chain is hazardous and all of its techniques alone are safe.

    Args:
        chain: The chain.
        share: Share of the streets in which it is unsafe.
        parts: The same for each technique at its level alone.
    """
    return share >= HAZARDOUS and all(parts[(step,)] <= SAFE for step in chain)


def draw_pairs(together: Mapping[NamedChain, float], parts: Mapping[NamedChain, float], path: Path) -> None:
    """Draw in how many streets each ordered pair of perturbations is unsafe, beside each perturbation alone.

    Args:
        together: Share of the streets in which each simulated pair is unsafe.
        parts: The same for each perturbation alone.
        path: The file.
    """
    # Imported here: matplotlib takes half a second to load.
    from matplotlib.patches import Rectangle

    from brink.pictures.figure import LiteralFigure

    steps = sorted(
        (chain[0] for chain in parts),
        key=lambda step: -sum(share for chain, share in together.items() if step in chain),
    )
    places = {step: place for place, step in enumerate(steps)}
    shares = np.full((len(steps), len(steps) + 1), np.nan)
    shares[:, 0] = [parts[(step,)] for step in steps]
    for (first, second), share in together.items():
        shares[places[first], places[second] + 1] = share
    figure = LiteralFigure(figsize=(8, 7.4), layout="constrained")
    axes = figure.subplots()
    axes.set_facecolor("#eeeeee")
    axes.imshow(shares, cmap="Oranges", vmin=0, vmax=1.25)
    for place in range(len(steps)):  # no technique follows itself
        axes.add_patch(Rectangle((place + 0.5, place - 0.5), 1, 1, color="white"))
    for (row, column), share in np.ndenumerate(shares):
        if np.isfinite(share):
            colour = "white" if share >= HAZARDOUS else "black"
            axes.text(
                column, row, f"{share * _PLACES:.0f}", color=colour, ha="center", va="center", fontsize=8
            )
    for chain, share in together.items():
        if is_only_together(chain, share, parts):
            corner = (places[chain[1]] + 0.54, places[chain[0]] - 0.46)
            axes.add_patch(Rectangle(corner, 0.92, 0.92, fill=False, edgecolor=_BLUE, linewidth=2, zorder=3))
    axes.axvline(0.5, color="white", linewidth=6)
    names = [words_of((step,)) for step in steps]
    axes.set_yticks(range(len(steps)), names)
    axes.set_xticks(range(len(steps) + 1), ["alone", *names], rotation=90)
    axes.xaxis.tick_top()
    axes.xaxis.set_label_position("top")
    axes.set(xlabel="applied second", ylabel="applied first")
    axes.tick_params(length=0)
    axes.spines[:].set_visible(False)
    least, most = math.ceil(HAZARDOUS * _PLACES - 1e-9), math.floor(SAFE * _PLACES + 1e-9)
    words = (
        f"In how many of {_PLACES} streets a drive is unsafe; each perturbation at its highest level that is",
        f"harmless in three other streets. Framed, hazardous only together: {least} or more, alone {most} at most.",
        "Grey: not simulated in these streets, since both orders are safe in another one.",
    )
    figure.supxlabel("\n".join(words), fontsize=9, x=0.02, ha="left")
    figure.savefig(path, dpi=120)


def draw_omega(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Draw Fig. 4: orders of techniques, mean intensity and mean alpha of the last populations, by omega.

    Args:
        rows: A row for each omega, with `omega`, `unique_orders`, `mean_intensity` and `mean_alpha`.
        path: The file.
    """
    from brink.pictures.figure import LiteralFigure

    figure = LiteralFigure(figsize=(7, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    omegas, orders, intensities, alphas = (
        [row[name] for row in rows] for name in ("omega", "unique_orders", "mean_intensity", "mean_alpha")
    )
    places = range(len(omegas))
    left.bar(places, orders, width=0.7, color=_BLUE)
    left.set(xlabel="omega", ylabel="orders of techniques in a last population")
    right.plot(places, intensities, "o-", color=_BLUE, label="mean intensity")
    right.plot(places, alphas, "s--", color=_ORANGE, label="mean alpha (mAP)")
    right.set(xlabel="omega", ylim=(0, 1))
    right.legend(frameon=False)
    for axes in (left, right):
        axes.spines[["top", "right"]].set_visible(False)
        axes.set_xticks(places, [f"{omega:g}" for omega in omegas])
    figure.savefig(path, dpi=120)
