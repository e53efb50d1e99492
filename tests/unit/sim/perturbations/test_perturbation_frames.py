"""Which frames are accepted, and what is said of others, and of transforms that fail."""

from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from perturbed_pictures import perturb, street

from brink.sim.perturbations import (
    CATALOGUE,
    Frame,
    Gene,
    InvalidFrame,
    Perturbation,
    PerturbationFailed,
    Pipeline,
    Transform,
    apply,
    catalogue,
    generator,
    register,
)

SIZES = [(48, 64), (192, 320), (359, 641), (720, 1280), (400, 120), (16, 16)]


@pytest.mark.parametrize("size", SIZES, ids=lambda size: f"{size[1]}x{size[0]}")
def test_any_size_works_at_every_level_shown(size: tuple[int, int]) -> None:
    frame = np.random.default_rng(2).integers(30, 220, (*size, 3), dtype=np.uint8)
    for gene in CATALOGUE.values():
        for level in gene.representative_levels:
            perturbed = perturb(frame, gene.name, level)
            assert (perturbed.shape, perturbed.dtype) == (frame.shape, frame.dtype), gene.name
            assert not np.array_equal(perturbed, frame), (gene.name, level)


@given(
    st.integers(16, 90),
    st.integers(16, 120),
    st.sampled_from(list(CATALOGUE.values())),
    st.integers(0, 2**53 - 1),
)
def test_no_size_and_seed_breaks_a_gene(height: int, width: int, gene: Gene, seed: int) -> None:
    frame = np.random.default_rng(0).integers(0, 256, (height, width, 3), dtype=np.uint8)
    for level in gene.representative_levels:
        assert perturb(frame, gene.name, level, seed=seed).shape == frame.shape


@pytest.mark.parametrize("gene", CATALOGUE)
def test_frames_may_be_read_only_and_need_not_be_contiguous(gene: str) -> None:
    frame = street(96)
    expected = perturb(np.ascontiguousarray(frame[:, ::-1, ::-1]), gene, 2)
    mirrored = frame[:, ::-1, ::-1]  # as when colours are swapped without a copy
    mirrored.flags.writeable = False
    np.testing.assert_array_equal(perturb(mirrored, gene, 2), expected)


@pytest.mark.parametrize(
    ("frame", "words"),
    [
        (np.zeros((40, 40, 3), dtype=np.float32), r"got a float32 array of shape \(40, 40, 3\)"),
        (np.zeros((40, 40), dtype=np.uint8), r"got a uint8 array of shape \(40, 40\)"),
        (np.zeros((40, 40, 4), dtype=np.uint8), r"got a uint8 array of shape \(40, 40, 4\)"),
        (
            np.zeros((15, 40, 3), dtype=np.uint8),
            r"at least 16 px a side; got a uint8 array of shape \(15, 40, 3\)",
        ),
        (np.zeros((0, 0, 3), dtype=np.uint8), r"shape \(0, 0, 3\)"),
        ([[1, 2, 3]], "got a list"),
    ],
)
def test_what_is_no_rgb_picture_is_refused(frame: Frame, words: str) -> None:
    for level in (0, 3):
        with pytest.raises(InvalidFrame, match=rf"expected an RGB picture: uint8.*{words}"):
            apply(frame, Perturbation("smoke", level), generator(0, 0, 0))
    with pytest.raises(InvalidFrame, match=words):
        Pipeline((), seed=0)(frame, 0)


@pytest.fixture
def own_gene() -> Iterator[Gene]:
    gene = Gene(name="faulty", values=(1,), unit="", effect="")
    yield gene
    catalogue._registered.pop(gene.name, None)


def _breaks(frame: Frame, value: float, rng: np.random.Generator) -> Frame:
    raise ZeroDivisionError("out of fog")


def _draws_on_its_input(frame: Frame, value: float, rng: np.random.Generator) -> Frame:
    frame[0] = 0
    return frame


@pytest.mark.parametrize(
    ("transform", "words"),
    [
        (_breaks, "faulty:1: ZeroDivisionError: out of fog"),
        (_draws_on_its_input, "faulty:1: ValueError: .*read-only"),
        (lambda frame, value, rng: None, "faulty:1: expected a uint8 frame .* back, got a NoneType"),
        (
            lambda frame, value, rng: frame[1:],
            r"faulty:1: .* of shape \(48, 85, 3\) back, got .* \(47, 85, 3\)",
        ),
        (lambda frame, value, rng: frame * 1.0, "faulty:1: expected a uint8 frame .* got a float64 array"),
    ],
)
def test_a_transform_that_fails_is_an_error_that_names_the_gene(
    own_gene: Gene, transform: Transform, words: str
) -> None:
    register(own_gene, transform)
    frame = street(48)
    before = frame.copy()
    pipeline = Pipeline((Perturbation("rain", 1), Perturbation("faulty", 1)), seed=0)
    with pytest.raises(PerturbationFailed, match=words):
        pipeline(frame, 0)
    np.testing.assert_array_equal(frame, before)
