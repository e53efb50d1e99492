"""A perturbation is a pure function of frame, level and address."""

import itertools

import numpy as np
import pytest
from perturbed_pictures import EFFECTIVE, blocks, digest, night, perturb, street
from support.marks import mostly_long

from brink.sim.perturbations import CATALOGUE, Mode, Perturbation, Pipeline, apply, field_of, generator

GENES = list(CATALOGUE)
DETERMINISTIC = {"gaussian_blur", "grid_dropout", "brightness", "contrast"}
TOP = {name: gene.levels - 1 for name, gene in CATALOGUE.items()}
EXTREMES = [one for one in EFFECTIVE if one.level in (1, TOP[one.gene])]
PAIRS = list(itertools.permutations(GENES, 2))


@pytest.mark.parametrize("gene", GENES)
def test_level_0_returns_the_frame_byte_for_byte(gene: str) -> None:
    frame = street()
    assert digest(perturb(frame, gene, 0)) == digest(frame)


@pytest.mark.parametrize("perturbation", mostly_long(EFFECTIVE, EXTREMES, "tries every level"), ids=str)
def test_every_other_level_changes_a_copy_of_the_frame(perturbation: Perturbation) -> None:
    for draw in (street, night, blocks):
        frame = draw()
        before = frame.copy()
        perturbed = apply(frame, perturbation, generator(3, 0, 0))
        np.testing.assert_array_equal(frame, before)
        assert (perturbed.shape, perturbed.dtype) == (frame.shape, frame.dtype)
        assert not np.array_equal(perturbed, frame), draw.__name__
        assert not np.shares_memory(perturbed, frame)


@pytest.mark.parametrize("gene", mostly_long(GENES, list(GENES)[::3], "perturbs with every gene"))
def test_the_same_address_gives_the_same_bytes_independent_of_history(gene: str) -> None:
    frame = street()
    first = digest(perturb(frame, gene, TOP[gene], seed=1, index=5))
    for height, level in ((100, 1), (180, 2), (216, TOP[gene])):
        perturb(street(height), gene, min(level, TOP[gene]), seed=2, index=height)
    assert digest(perturb(frame, gene, TOP[gene], seed=1, index=5)) == first


@pytest.mark.parametrize("gene", [gene for gene in GENES if gene not in DETERMINISTIC])
def test_seed_field_and_frame_each_change_the_random_fields(gene: str) -> None:
    frame = blocks()
    level = 1 if gene == "channel_dropout" else TOP[gene]
    for word in ("seed", "field", "index"):
        drawn = {digest(perturb(frame, gene, level, **{word: value})) for value in range(12)}
        assert len(drawn) > 1, word


@pytest.mark.parametrize("gene", sorted(DETERMINISTIC))
def test_deterministic_genes_do_not_depend_on_the_address(gene: str) -> None:
    frame = blocks()
    assert digest(perturb(frame, gene, 3, seed=1)) == digest(perturb(frame, gene, 3, seed=2, index=7))


def test_all_210_ordered_pairs_run() -> None:
    frame = street(90)
    assert len(PAIRS) == 210
    for first, second in PAIRS:
        pair = (Perturbation(first, TOP[first]), Perturbation(second, TOP[second]))
        perturbed = Pipeline(pair, seed=1)(frame, 0)
        assert (perturbed.shape, perturbed.dtype) == (frame.shape, frame.dtype)


def test_the_second_gene_is_applied_to_the_result_of_the_first() -> None:
    frame = street()
    first, second = Perturbation("smoke", 5), Perturbation("rain", 3)
    both = Pipeline((first, second), seed=4)(frame, 7)
    half = apply(frame, first, generator(4, field_of("smoke"), 7))
    np.testing.assert_array_equal(both, apply(half, second, generator(4, field_of("rain"), 7)))
    assert not np.array_equal(both, apply(frame, second, generator(4, field_of("rain"), 7)))


def test_a_gene_has_the_same_random_field_alone_and_in_any_position() -> None:
    frame = street()
    noise, nothing = Perturbation("gaussian_noise", 4), Perturbation("rain", 0)
    alone = Pipeline((noise,), seed=4)(frame, 7)
    for chain in ((noise, nothing), (nothing, noise)):
        np.testing.assert_array_equal(Pipeline(chain, seed=4)(frame, 7), alone)
    brighter = Perturbation("contrast", 2)
    after = Pipeline((brighter, noise), seed=4)(frame, 7)
    own = apply(Pipeline((brighter,), seed=4)(frame, 7), noise, generator(4, field_of("gaussian_noise"), 7))
    np.testing.assert_array_equal(after, own)


def test_a_gene_that_is_listed_twice_has_two_random_fields() -> None:
    dark, dropout = np.zeros((180, 320, 3), np.uint8) + 200, Perturbation("coarse_dropout", 1)
    once = (Pipeline((dropout,), seed=4)(dark, 0) == 0).sum()
    twice = (Pipeline((dropout, dropout), seed=4)(dark, 0) == 0).sum()
    assert twice > once, "other squares than the first time"


@pytest.mark.parametrize("gene", ["dirty", "broken_lens", "gaussian_noise", "rain", "snow"])
def test_random_fields_are_drawn_per_episode_or_per_frame(gene: str) -> None:
    frame = street()
    perturbations = (Perturbation(gene, TOP[gene]),)
    static = Pipeline(perturbations, seed=2, mode=Mode.PER_EPISODE)
    changing = Pipeline(perturbations, seed=2)
    assert changing.mode is Mode.PER_FRAME
    assert digest(static(frame, 0)) == digest(static(frame, 9)) == digest(changing(frame, 0))
    assert digest(changing(frame, 9)) != digest(changing(frame, 0))


def test_an_empty_list_and_level_0_return_the_frame_itself() -> None:
    frame = street()
    assert Pipeline((), seed=0)(frame, 0) is frame
    assert Pipeline((Perturbation("rain", 0), Perturbation("smoke", 0)), seed=0)(frame, 3) is frame
