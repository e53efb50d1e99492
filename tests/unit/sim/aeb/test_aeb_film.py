"""What a camera in the loop saw: kept, scored again, drawn."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from aeb_episodes import spec
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from PIL import Image

from brink.sim import catalogue
from brink.sim.aeb.braking import PERSON, Detection, EmergencyBrake
from brink.sim.aeb.scores import rescored
from brink.sim.aeb.simulator import BrinkAeb
from brink.sim.episode import Json
from brink.sim.perception.quality import Found
from brink.sim.perception.registry import DETECTORS
from brink.sim.replay import ReplayError, render
from brink.sim.replay.frame import FramePainter
from brink.sim.replay.sheets import HEADER_PX, MARGIN, TILE_PX, Row, side_by_side
from brink.sim.replay.style import FOUND_ON_PICTURE, SEEN_ON_PICTURE
from brink.sim.trace import Film, Trace

COLUMN, ROW = st.floats(-50, 700, width=32), st.floats(-50, 360, width=32)
WARNING = EmergencyBrake.for_picture(640, 360).warning


class Half:
    """Finds somebody in the lane in every second picture, more or less sure, and a vehicle that is not there."""

    def __init__(self) -> None:
        self.looks = 0

    def detect(self, picture: NDArray[np.uint8]) -> Found:
        """Return one box or two."""
        self.looks += 1
        boxes = np.array([[300, 150, 340, 320], [20, 20, 80, 60]], np.float32)
        scores = np.array([0.9 if self.looks % 2 else 0.1, 0.5], np.float32)
        return Found(labels=np.array([1, 0]), boxes=boxes, scores=scores)


@pytest.fixture(scope="module")
def trace() -> Trace:
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(catalogue._registered, DETECTORS, {"half@1": Half})
        behaviour: dict[str, Json] = {"mode": "detector", "detector": "half@1", "threshold": 0.4,
                     "perturbations": [{"gene": "snow", "level": 3}]}  # fmt: skip
        result = BrinkAeb().run(replace(spec(3), behaviour=behaviour, duration_s=4.0), record=True)
    assert result.trace is not None
    kept = Trace.from_bytes(result.trace)
    assert kept.film is not None
    again = rescored(kept.film, 0.4)
    assert again.recall_inside == pytest.approx(result.features["recall_inside"])
    assert again.precision == pytest.approx(result.features["precision"])
    assert again.alpha == pytest.approx(result.objectives["alpha"])
    return kept


def film_of(trace: Trace) -> Film:
    assert trace.film is not None
    return trace.film


def test_a_film_survives_its_file_and_scores_as_the_episode_did(trace: Trace) -> None:
    film = film_of(trace)
    again = film_of(Trace.from_bytes(trace.to_bytes()))
    assert again.pictures == film.pictures
    assert np.array_equal(again.found.rows, film.found.rows)
    assert np.array_equal(again.judged.rows, film.judged.rows)
    assert {name: corners.tolist() for name, corners in again.regions.items()} == {
        name: corners.tolist() for name, corners in film.regions.items()
    }


def test_another_threshold_needs_no_simulation(trace: Trace) -> None:
    film = film_of(trace)
    sure, unsure = rescored(film, 0.4), rescored(film, 0.05)
    assert sure.alpha == unsure.alpha
    assert unsure.recall >= sure.recall
    assert np.isnan(rescored(film, 0.99).precision), "nothing was found that surely"


def test_every_frame_has_its_boxes_and_every_second_its_picture(trace: Trace) -> None:
    film = film_of(trace)
    frames = len(trace.time_s) - 1
    assert film.samples.tolist() == list(range(0, frames, 2))
    assert np.diff(film.found.first)[:frames].tolist() == [2] * frames


def test_the_picture_is_drawn_with_boxes_and_regions(trace: Trace, tmp_path: Path) -> None:
    painter = FramePainter(trace)
    picture = np.asarray(painter.camera(0)).reshape(-1, 3)
    for colour in (SEEN_ON_PICTURE, FOUND_ON_PICTURE):
        assert (picture == colour).all(axis=1).any()
    files = [render(trace, tmp_path / f"film{suffix}") for suffix in (".png", ".mp4")]
    with Image.open(files[0]) as picture_file:
        assert picture_file.size[0] == 1280
    assert files[1].stat().st_size > 10_000


@given(COLUMN, COLUMN, ROW, ROW)
def test_boxes_meet_the_region_together_as_they_do_alone(a: float, b: float, c: float, d: float) -> None:
    box = Detection(PERSON, min(a, b), min(c, d), max(a, b), max(c, d))
    rows = np.linspace(box.y_min_px, min(box.y_max_px, 360.0), 400)
    inside = rows[rows >= 235.0]
    half = 0.5 * (115.0 + (inside - 235.0) / 125.0 * 250.0)
    touches = bool(np.any((box.x_min_px <= 320 + half) & (box.x_max_px >= 320 - half)))
    assert WARNING.meets(box) is touches


def test_episodes_stand_side_by_side_at_the_same_moments(trace: Trace) -> None:
    one = side_by_side([Row(words="snow 3/5", trace=trace)], title="one")
    both = side_by_side(
        [Row(words="nothing", trace=trace), Row(words="snow 3/5, then rain 5/5", trace=trace)]
    )
    assert both.width == one.width
    assert both.height - one.height == TILE_PX[1] + MARGIN
    pixels = np.asarray(both)
    assert np.array_equal(
        pixels[HEADER_PX : HEADER_PX + TILE_PX[1], -TILE_PX[0] :],
        pixels[HEADER_PX + TILE_PX[1] + MARGIN : HEADER_PX + 2 * TILE_PX[1] + MARGIN, -TILE_PX[0] :],
    )
    with pytest.raises(ReplayError, match="no pictures"):
        side_by_side([Row(words="x", trace=replace(trace, film=None))])
    with pytest.raises(ReplayError, match="no episodes"):
        side_by_side([])
