"""Strength grows with the level: the search takes the rank of a level for its intensity."""

import cv2
import numpy as np
import pytest
from perturbed_pictures import blocks, night, perturb, street

from brink.sim.perturbations import CATALOGUE, Frame

BY_DIFFERENCE = [name for name in CATALOGUE if name not in ("grid_dropout", "rain")]
DRAWS = 6


@pytest.mark.parametrize("gene", BY_DIFFERENCE)
def test_the_mean_difference_grows_from_level_to_level(gene: str) -> None:
    levels = range(1, CATALOGUE[gene].levels)
    frames = (street(), night(), street()[:, ::-1])
    strength = [
        np.mean(
            [
                cv2.absdiff(perturb(frame, gene, level, seed=seed), np.ascontiguousarray(frame)).mean()
                for frame in frames
                for seed in range(DRAWS)
            ]
        )
        for level in levels
    ]
    slack = 0.02 * strength[-1] + 1e-9
    assert strength[0] > 0
    assert (np.diff(strength) >= -slack).all(), np.round(strength, 2)
    assert strength[-1] > 1.15 * strength[0]


def unlike(a: Frame, b: Frame, sigma_px: float) -> float:
    """Return one less the correlation of two pictures whose details below a size are wiped out."""
    smooth = [cv2.GaussianBlur(picture, (0, 0), sigma_px)[..., 1].ravel().astype(float) for picture in (a, b)]
    return float(1 - np.corrcoef(smooth[0], smooth[1])[0, 1])


def test_larger_holes_of_a_grid_hide_more_although_their_area_stays() -> None:
    frames = (street(720), blocks(720))
    levels = range(1, 9)
    holes = [(perturb(np.full_like(frames[0], 9), "grid_dropout", level) == 0).mean() for level in levels]
    assert holes == pytest.approx([0.25] * 8, abs=0.03)  # so the mean difference says nothing
    strength = [
        np.mean([unlike(perturb(f, "grid_dropout", level), f, 16.0) for f in frames]) for level in levels
    ]
    assert (np.diff(strength) > 0).all(), strength


def test_rain_hides_more_from_drizzle_to_torrent_and_behind_a_wet_lens() -> None:
    # The mean difference is mostly that every kind is equally dark.
    drizzle, heavy, torrential, heavy_wet, torrential_wet = (
        np.mean(
            [unlike(perturb(street(360), "rain", level, seed=seed), street(360), 1.0) for seed in range(8)]
        )
        for level in range(1, 6)
    )
    assert drizzle < heavy < torrential < torrential_wet
    assert heavy < heavy_wet < torrential  # the table's order of kinds: 4 is 2 behind a wet lens, not 3
