"""Augmentation of training images: pure, reproducible, and the boxes follow the image."""

import ast
import inspect
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from benchmarks.training import augmentation
from benchmarks.training.augmentation import augment, collage, mirror, zoom
from brink.sim.perception.boxes import GroundTruth
from brink.sim.perturbations.catalogue import CATALOGUE

SIZE_PX = (320, 192)
CHANGES = [change for change, _ in augmentation._CHANGES]


def picture(seed: int = 0) -> NDArray[np.uint8]:
    return np.random.default_rng(seed).integers(0, 256, (SIZE_PX[1], SIZE_PX[0], 3), dtype=np.uint8)


def marked(*boxes: tuple[int, int, int, int]) -> tuple[NDArray[np.uint8], GroundTruth]:
    """Return a black image with white boxes, which are its ground truth."""
    shown = np.zeros((SIZE_PX[1], SIZE_PX[0], 3), np.uint8)
    for left, upper, right, lower in boxes:
        shown[upper:lower, left:right] = 255
    return shown, GroundTruth(
        labels=np.arange(len(boxes)) % 2,
        boxes=np.array(boxes, np.float32).reshape(len(boxes), 4),
        ignored=np.zeros(len(boxes), np.bool_),
    )


def bright_box(shown: NDArray[np.uint8]) -> list[int]:
    rows, columns = np.nonzero(shown.min(axis=2) > 200)
    return [columns.min(), rows.min(), columns.max() + 1, rows.max() + 1]


@pytest.mark.parametrize("change", CHANGES, ids=lambda change: change.__name__)
@pytest.mark.parametrize("seed", range(8))
def test_a_change_is_reproducible_and_leaves_its_input_alone(
    change: Callable[[NDArray[np.uint8], np.random.Generator], NDArray[np.uint8]], seed: int
) -> None:
    shown = picture()
    first, again = (change(shown, np.random.default_rng(seed)) for _ in range(2))
    assert first.dtype == np.uint8
    assert first.shape == shown.shape
    assert np.array_equal(first, again)
    assert not np.array_equal(first, shown)
    assert np.array_equal(shown, picture())


def test_no_perturbation_is_used_in_training() -> None:
    imported = {
        name
        for node in ast.walk(ast.parse(inspect.getsource(augmentation)))
        if isinstance(node, ast.ImportFrom | ast.Import)
        for name in (
            [node.module or ""] if isinstance(node, ast.ImportFrom) else [n.name for n in node.names]
        )
    }
    assert not any("perturbations" in name for name in imported)
    names = {change.__name__ for change in CHANGES}
    assert not names & set(CATALOGUE)


def test_a_mirrored_box_covers_the_mirrored_body() -> None:
    shown, truth = mirror(*marked((10, 40, 60, 90)))
    assert truth.boxes[0].tolist() == bright_box(shown) == [260, 40, 310, 90]


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("size_px", [SIZE_PX, (224, 160)])
def test_boxes_follow_a_zoom(seed: int, size_px: tuple[int, int]) -> None:
    shown, truth = zoom(*marked((130, 80, 190, 120)), np.random.default_rng(seed), size_px)
    assert shown.shape == (size_px[1], size_px[0], 3)
    for box, ignored in zip(truth.boxes, truth.ignored, strict=True):
        if not ignored:
            assert np.abs(box - bright_box(shown)).max() <= 1.0


def test_a_box_that_a_zoom_cuts_off_is_ignored_or_gone() -> None:
    seen = set()
    for seed in range(60):
        _, truth = zoom(*marked((0, 80, 40, 120)), np.random.default_rng(seed), (224, 160))
        area = np.prod(truth.boxes[:, 2:] - truth.boxes[:, :2], axis=1)
        seen.add("gone" if not len(area) else "ignored" if truth.ignored[0] else "counts")
    assert seen == {"gone", "ignored", "counts"}


def test_a_box_that_a_collage_covers_is_ignored() -> None:
    shown, truth = marked(*((x, 60, x + 20, 100) for x in range(0, 320, 40)))
    black = np.zeros_like(shown)
    seen = set()
    for seed in range(20):
        changed, judged = collage(shown, truth, black, np.random.default_rng(seed))
        for (left, upper, right, lower), ignored in zip(
            truth.boxes.astype(int).tolist(), judged.ignored.tolist(), strict=True
        ):
            covered = float((changed[upper:lower, left:right, 0] == 0).mean())
            assert ignored == (covered > augmentation.MAX_COVERED)
            seen.add(ignored)
    assert seen == {True, False}


def test_augmentation_keeps_the_ground_truth_in_the_image() -> None:
    shown, truth = marked((20, 70, 90, 130), (150, 60, 165, 110), (250, 80, 300, 150))
    rng = np.random.default_rng(0)
    for _ in range(50):
        changed, judged = augment(shown, truth, picture(1), rng)
        assert changed.shape == shown.shape
        assert judged.boxes.min(initial=0) >= 0
        assert (judged.boxes <= [*SIZE_PX, *SIZE_PX]).all()
        assert len(judged.labels) == len(judged.boxes) == len(judged.ignored)
