"""The catalogue of genes, how perturbations are written, and which frames and transforms are accepted."""

import subprocess
import sys
from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from perturbed_pictures import perturb, street

from brink.extras import install_command
from brink.sim.errors import InvalidEpisode
from brink.sim.perturbations import (
    CATALOGUE,
    Frame,
    Gene,
    InvalidFrame,
    InvalidPerturbation,
    Mode,
    Perturbation,
    PerturbationFailed,
    Pipeline,
    Transform,
    apply,
    catalogue,
    find_gene,
    generator,
    parse_perturbations,
    register,
)
from brink.sim.perturbations.transforms import TRANSFORMS

# Ferreira et al. 2022, table I: level 0 included.
PUBLISHED = {
    "shifted_pixels": 11,
    "gaussian_noise": 8,
    "gaussian_blur": 24,
    "grid_dropout": 9,
    "coarse_dropout": 31,
    "channel_dropout": 3,
    "snow": 6,
    "broken_lens": 11,
    "dirty": 11,
    "condensation": 11,
    "sun_flare": 11,
    "brightness": 11,
    "contrast": 11,
    "rain": 6,
    "smoke": 11,
}


def test_there_are_15_genes_with_the_published_175_levels_of_which_160_have_an_effect() -> None:
    assert {name: gene.levels for name, gene in CATALOGUE.items()} == PUBLISHED
    assert list(CATALOGUE) == list(PUBLISHED) == list(TRANSFORMS)
    assert sum(gene.levels for gene in CATALOGUE.values()) == 175
    assert sum(len(gene.values) for gene in CATALOGUE.values()) == 160


def test_values_match_the_published_table() -> None:
    values = {name: gene.values for name, gene in CATALOGUE.items()}
    assert values["shifted_pixels"] == (0.5, 0.45, 0.4, 0.35, 0.3, 0.25, 0.2, 0.15, 0.1, 0.05)
    assert values["gaussian_noise"] == (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7)
    assert list(values["gaussian_blur"]) == list(range(1, 46, 2))
    assert list(values["coarse_dropout"]) == [*range(10, 39), 40]
    assert values["smoke"] == tuple(round(0.03 * i, 2) for i in range(1, 11))
    for name, ends in {
        "broken_lens": (0.3, 0.8),
        "dirty": (0.3, 0.8),
        "condensation": (0.1, 0.6),
        "sun_flare": (400, 900),
        "brightness": (0.3, 0.8),
        "contrast": (0.2, 0.7),
    }.items():
        assert values[name] == pytest.approx(np.linspace(*ends, 10), abs=0.5 if name == "sun_flare" else 1e-4)


def test_the_two_published_levels_without_effect_are_replaced() -> None:
    assert list(CATALOGUE["snow"].values) == [1.5, 2, 3, 4, 5]
    assert CATALOGUE["gaussian_blur"].values[0] == 1  # its kernel is 3 px


def test_intensity_is_the_rank_of_the_level_not_its_value() -> None:
    shifted = CATALOGUE["shifted_pixels"]
    assert [shifted.intensity(level) for level in (0, 1, 10)] == [0, 0.1, 1]
    assert shifted.value(10) == 0.05  # the strong end
    for gene in CATALOGUE.values():
        ranks = [gene.intensity(level) for level in range(gene.levels)]
        assert ranks == sorted(ranks)
        assert (ranks[0], ranks[-1]) == (0, 1)


def test_numpy_levels_are_stored_as_plain_integers() -> None:
    perturbation = Perturbation("rain", np.int64(3))  # type: ignore[arg-type]
    assert perturbation == Perturbation("rain", 3)
    assert type(perturbation.to_json()["level"]) is int


def test_a_pipeline_refuses_other_objects_and_negative_seeds() -> None:
    with pytest.raises(InvalidPerturbation, match="got 'rain:3'; use parse_perturbations"):
        Pipeline(("rain:3",), seed=0)  # type: ignore[arg-type]
    for seed in (-1, 1.5, True, "1"):
        with pytest.raises(InvalidPerturbation, match=f"seed: expected an integer >= 0, got {seed!r}"):
            Pipeline((), seed=seed)  # type: ignore[arg-type]


@pytest.mark.parametrize("mode", Mode)
@pytest.mark.parametrize("index", [-1, 1.0, True, "3", None, np.int64(-1), np.float32(2)])
def test_an_index_that_is_not_of_a_frame_is_refused(index: int, mode: Mode) -> None:
    for perturbations in ((), (Perturbation("rain", 1),)):
        with pytest.raises(
            InvalidFrame, match="index: expected the index of a frame, an integer >= 0, got"
        ) as caught:
            Pipeline(perturbations, seed=0, mode=mode)(street(48), index)
        assert repr(index) in str(caught.value)


@pytest.mark.parametrize("words", [(-1, 0, 0), (0, 1.0, 0), (0, 0, True)])
def test_a_generator_is_addressed_by_whole_numbers(words: tuple[int, int, int]) -> None:
    with pytest.raises(InvalidPerturbation, match=r"(seed|field|frame): expected an integer >= 0, got"):
        generator(*words)
    assert generator(1, 2, np.int64(3)).random() == generator(1, 2, 3).random()  # type: ignore[arg-type]


@settings(deadline=None)
@given(st.sampled_from(list(CATALOGUE.values())), st.data())
def test_a_perturbation_survives_json_and_text(gene: Gene, data: st.DataObject) -> None:
    perturbation = Perturbation(gene.name, data.draw(st.integers(0, gene.levels - 1)))
    assert Perturbation.from_json(perturbation.to_json()) == perturbation
    assert Perturbation.parse(str(perturbation)) == perturbation


def test_a_list_of_perturbations_keeps_its_order() -> None:
    read = parse_perturbations(["rain:2", {"gene": "smoke", "level": 3}])
    assert read == (Perturbation("rain", 2), Perturbation("smoke", 3))


@pytest.mark.parametrize(
    ("item", "words"),
    [
        ("fog:1", "unknown perturbation 'fog'; expected one of shifted_pixels"),
        ("rain", "such as smoke:3, got 'rain'"),
        ("rain:-1", "such as smoke:3, got 'rain:-1'"),
        ("rain:6", r"rain: expected a level from 0 to 5 \(0 has no effect\), got 6"),
        ({"gene": "rain"}, "expected a perturbation such as"),
        ({"gene": "rain", "level": 1, "x": 2}, "expected a perturbation such as"),
        ({"gene": "rain", "level": 1.0}, "expected a level from 0 to 5"),
        ({"gene": "rain", "level": True}, "expected a level from 0 to 5"),
        ({"gene": ["rain"], "level": 1}, "expected the name of a perturbation"),
        (None, "expected a perturbation such as"),
    ],
)
def test_an_invalid_perturbation_is_refused_with_its_position(item: object, words: str) -> None:
    with pytest.raises(InvalidPerturbation, match=rf"^perturbations\[1\]: .*{words}") as caught:
        parse_perturbations(["rain:1", item])  # type: ignore[list-item]
    assert isinstance(caught.value, InvalidEpisode)  # final: workers do not retry it


@pytest.fixture
def own_gene() -> Iterator[Gene]:
    gene = Gene(name="custom", values=(1,), unit="", effect="")
    yield gene
    catalogue._registered.pop(gene.name, None)


def test_a_registered_gene_works_like_those_of_the_catalogue(own_gene: Gene) -> None:
    def turn(frame: Frame, value: float, rng: np.random.Generator) -> Frame:
        return frame[::-1]

    register(own_gene, turn)
    assert find_gene("custom") is own_gene
    frame = np.random.default_rng(0).integers(0, 256, (20, 30, 3), dtype=np.uint8)
    turned = apply(frame, Perturbation.parse("custom:1"), generator(0, 0, 0))
    np.testing.assert_array_equal(turned, frame[::-1])


def test_a_registered_gene_cannot_reuse_a_name_of_the_catalogue() -> None:
    gene = Gene(name="rain", values=(1,), unit="", effect="")
    with pytest.raises(InvalidPerturbation, match="rain: the catalogue already has a gene with that name"):
        register(gene, lambda frame, value, rng: frame)


def test_the_catalogue_can_be_read_without_opencv() -> None:
    code = (
        "import sys; sys.modules['cv2'] = None\n"
        "import numpy as np\n"
        "from brink.sim.perturbations import CATALOGUE, VisionMissing, Perturbation, apply, generator\n"
        "assert len(CATALOGUE) == 15\n"
        "try: apply(np.zeros((20, 20, 3), np.uint8), Perturbation('rain', 1), generator(0, 0, 0))\n"
        "except VisionMissing as error: print(error)\n"
    )
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert install_command("vision") in said


@settings(deadline=None)
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
    mirrored = frame[:, ::-1, ::-1]  # a view, as after swapping colour channels
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
def test_arrays_other_than_rgb_pictures_are_refused(frame: Frame, words: str) -> None:
    for level in (0, 3):
        with pytest.raises(InvalidFrame, match=rf"expected an RGB image: uint8.*{words}"):
            apply(frame, Perturbation("smoke", level), generator(0, 0, 0))
    with pytest.raises(InvalidFrame, match=words):
        Pipeline((), seed=0)(frame, 0)


def _breaks(frame: Frame, value: float, rng: np.random.Generator) -> Frame:
    raise ZeroDivisionError("out of fog")


def _draws_on_its_input(frame: Frame, value: float, rng: np.random.Generator) -> Frame:
    frame[0] = 0
    return frame


@pytest.mark.parametrize(
    ("transform", "words"),
    [
        (_breaks, "custom:1: ZeroDivisionError: out of fog"),
        (_draws_on_its_input, "custom:1: ValueError: .*read-only"),
        (
            lambda frame, value, rng: None,
            "custom:1: expected a uint8 frame .* from the transform, got a NoneType",
        ),
        (
            lambda frame, value, rng: frame[1:],
            r"custom:1: .* of shape \(48, 85, 3\) from the transform, got .* \(47, 85, 3\)",
        ),
        (lambda frame, value, rng: frame * 1.0, "custom:1: expected a uint8 frame .* got a float64 array"),
    ],
)
def test_a_failing_transform_names_the_gene(own_gene: Gene, transform: Transform, words: str) -> None:
    register(own_gene, transform)
    frame = street(48)
    before = frame.copy()
    pipeline = Pipeline((Perturbation("rain", 1), Perturbation("custom", 1)), seed=0)
    with pytest.raises(PerturbationFailed, match=words):
        pipeline(frame, 0)
    np.testing.assert_array_equal(frame, before)
