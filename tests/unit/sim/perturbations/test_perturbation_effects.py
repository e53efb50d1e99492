"""Each effect against an independent implementation of its definition, and its strength by level.

The search uses the rank of a level as its intensity, so strength must grow with the level.
"""

import cv2
import numpy as np
import pytest
from perturbed_pictures import blocks, grey, night, perturb, street
from scipy.stats import norm
from support.marks import mostly_long

from brink.sim.perturbations import CATALOGUE, Frame
from brink.sim.perturbations.layers import composite_white, darken_complement, to_layer
from brink.sim.perturbations.lens import transmission
from brink.sim.perturbations.weather import count_discs, draw_discs


@pytest.mark.parametrize(("level", "height"), [(1, 720), (6, 720), (10, 720), (10, 360), (1, 90)])
def test_rows_shift_cyclically_to_the_left_by_at_most_int_3_over_v(level: int, height: int) -> None:
    frame = np.random.default_rng(0).integers(0, 256, (height, 200, 3), dtype=np.uint8)
    value = CATALOGUE["shifted_pixels"].value(level)
    assert value is not None
    most = max(1, round(int(3 / value) * height / 720))
    shifted = perturb(frame, "shifted_pixels", level)
    equal = np.array([(np.roll(frame, -s, axis=1) == shifted).all(axis=(1, 2)) for s in range(most + 1)])
    assert (equal.sum(axis=0) == 1).all()  # each row is shifted by one of these
    assert equal[0].any()
    assert equal[most].any()


@pytest.mark.parametrize("level", range(1, 8))
def test_unclipped_noise_is_normal_with_variance_v(level: int) -> None:
    value = CATALOGUE["gaussian_noise"].value(level)
    assert value is not None
    sigma = 255 * np.sqrt(value)
    noise = perturb(grey(127), "gaussian_noise", level).astype(int) - 127
    assert abs(np.median(noise)) <= 0.5
    for limit in (-100, -50, 50, 100):  # shares below a limit, because the tails are clipped
        assert np.mean(noise <= limit) == pytest.approx(norm.cdf((limit + 0.5) / sigma), abs=2e-3)
    neighbours = np.corrcoef(noise[:, :-1, 0].ravel(), noise[:, 1:, 0].ravel())[0, 1]
    channels = np.corrcoef(noise[..., 0].ravel(), noise[..., 1].ravel())[0, 1]
    assert max(abs(neighbours), abs(channels)) < 0.01


@pytest.mark.parametrize(("level", "kernel"), [(2, 3), (6, 11), (8, 15)])
def test_a_narrow_blur_equals_opencvs_with_the_published_sigma(level: int, kernel: int) -> None:
    frame = street(720)
    expected = cv2.GaussianBlur(frame, (kernel, kernel), 0.3 * ((kernel - 1) / 2 - 1) + 0.8)
    np.testing.assert_array_equal(perturb(frame, "gaussian_blur", level), expected)


def exact_blur(frame: Frame, side: int, sigma_px: float) -> np.ndarray:
    """Blur in floating point."""
    weights = np.exp(-((np.arange(side) - side // 2) ** 2) / (2 * sigma_px**2))
    kernel = weights / weights.sum()
    return cv2.sepFilter2D(frame.astype(np.float64), -1, kernel, kernel)


@pytest.mark.parametrize(
    ("level", "height"), [(9, 720), (12, 720), (23, 720), (20, 360), (23, 359), (23, 480)]
)
def test_a_wide_blur_is_as_close_to_the_exact_one_as_opencvs(level: int, height: int) -> None:
    value = CATALOGUE["gaussian_blur"].value(level)
    assert value is not None
    kernel_px = value * height / 720
    side, sigma_px = 2 * round((kernel_px - 1) / 2) + 1, 0.3 * ((kernel_px - 1) / 2 - 1) + 0.8
    noise = np.random.default_rng(0).integers(0, 256, (height, height * 16 // 9, 3), dtype=np.uint8)
    edges = cv2.threshold(cv2.resize(noise[::40, ::40], noise.shape[1::-1]), 127, 255, cv2.THRESH_BINARY)[1]
    for picture in (cv2.resize(street(720), noise.shape[1::-1]), noise, edges):
        frame = picture.astype(np.uint8)
        exact = exact_blur(frame, side, sigma_px)
        ours = np.abs(perturb(frame, "gaussian_blur", level) - exact)
        opencvs = np.abs(cv2.GaussianBlur(frame, (side, side), sigma_px) - exact)
        assert ours.max() <= 2.5
        assert ours.mean() <= opencvs.mean() + 0.1


def test_the_weakest_blur_has_a_kernel_of_3_and_the_sigma_of_1() -> None:
    frame = street(720)
    np.testing.assert_array_equal(perturb(frame, "gaussian_blur", 1), cv2.GaussianBlur(frame, (3, 3), 0.5))


@pytest.mark.parametrize(("level", "height"), [(1, 720), (8, 720), (4, 360)])
def test_grid_squares_are_half_a_cell_at_the_top_left_of_each_cell(level: int, height: int) -> None:
    frame = grey(200, height, height * 16 // 9)
    cell = 10 * level * height // 720
    expected = frame.copy()
    for y in range(0, height, cell):
        for x in range(0, frame.shape[1], cell):
            expected[y : y + cell // 2, x : x + cell // 2] = 0
    np.testing.assert_array_equal(perturb(frame, "grid_dropout", level), expected)


def test_coarse_dropout_blackens_v_plus_5_squares_of_v_px() -> None:
    for level, side in ((1, 10), (30, 40)):
        areas = []
        for seed in range(20):
            black = (perturb(grey(200), "coarse_dropout", level, seed=seed) == 0).all(axis=2)
            areas.append(black.sum())
            _, _, stats, _ = cv2.connectedComponentsWithStats(black.astype(np.uint8))
            assert (stats[1:, 2:4] >= side).all()  # no square is clipped
        assert max(areas) <= (side + 5) * side**2
        assert max(areas) >= 0.97 * (side + 5) * side**2  # when hardly any squares overlap


@pytest.mark.parametrize("level", [1, 2])
def test_channel_dropout_zeroes_exactly_v_channels(level: int) -> None:
    frame = grey(77, 90, 160)
    zeroed = set()
    for seed in range(30):
        dropped = perturb(frame, "channel_dropout", level, seed=seed)
        channels = [c for c in range(3) if not dropped[..., c].any()]
        assert len(channels) == level
        kept = [c for c in range(3) if c not in channels]
        assert (dropped[..., kept] == 77).all()
        zeroed |= set(channels)
    assert zeroed == {0, 1, 2}


@pytest.mark.parametrize("level", range(1, 11))
def test_brightness_adds_and_contrast_multiplies_with_clipping(level: int) -> None:
    frame = blocks()
    added = CATALOGUE["brightness"].value(level)
    gain = CATALOGUE["contrast"].value(level)
    assert added is not None
    assert gain is not None
    brighter = np.clip(frame.astype(int) + round(255 * added), 0, 255)
    np.testing.assert_array_equal(perturb(frame, "brightness", level), brighter)
    steeper = np.clip(frame * (1 + gain), 0, 255)
    assert np.abs(perturb(frame, "contrast", level) - steeper).max() <= 0.51


def scaled_in_hls(frame: Frame, factor: float) -> Frame:
    hls = cv2.cvtColor(frame, cv2.COLOR_RGB2HLS)
    hls[:, :, 1] = cv2.convertScaleAbs(hls[:, :, 1], alpha=factor)
    return np.asarray(cv2.cvtColor(hls, cv2.COLOR_HLS2RGB), np.uint8)


def test_rain_scales_the_lightness_by_07_like_the_slower_way_over_hls() -> None:
    for frame, close in ((street(720), 5), (night(720), 2), (blocks(720), 9)):
        smooth = cv2.blur(frame, (7, 7)).astype(np.uint8)
        difference = np.abs(
            darken_complement(255 - smooth, 0.7).astype(int) - scaled_in_hls(smooth, 0.7).astype(int)
        )
        assert difference.mean() < 4
        assert np.percentile(difference, 90 if frame.std() > 70 else 99) <= close


@pytest.mark.parametrize("value", range(0, 256, 15))
def test_rain_makes_every_grey_07_as_light(value: int) -> None:
    darkened = darken_complement(255 - grey(value, 90, 160), 0.7)
    assert np.abs(darkened.astype(int) - 0.7 * value).max() <= 1.5


def naive_smoke(frame: Frame, centres: np.ndarray, radii: np.ndarray, opacity: float) -> np.ndarray:
    """Composite the discs one by one in floating point."""
    out = frame.astype(float)
    ys, xs = np.mgrid[: frame.shape[0], : frame.shape[1]]
    for (x, y), radius in zip(centres, radii, strict=True):
        inside = (xs - x) ** 2 + (ys - y) ** 2 <= radius**2
        out[inside] = out[inside] * (1 - opacity) + 255 * opacity
    return out


@pytest.mark.parametrize("opacity", [0.01, 0.1, 0.3])
def test_smoke_in_closed_form_equals_compositing_disc_by_disc(opacity: float) -> None:
    frame = street(60)
    height, width = frame.shape[:2]
    centres, radii = draw_discs(height, width, 0.8, np.random.default_rng(5))
    counts = count_discs((height, width), centres, radii)
    closed = composite_white(frame, to_layer(((1 - opacity) ** counts).astype(np.float32)))
    assert np.abs(closed - naive_smoke(frame, centres, radii, opacity)).max() <= 1.5


def test_flare_transmission_is_the_product_over_its_rings() -> None:
    n, radius = 40, 400.0
    ring = np.linspace(1, radius, n)
    beta = [(1 - i / (n - 1)) ** 3 for i in range(n)]
    distances = np.array([0.0, 0.5, 1.0, 50.0, 123.4, 200.0, 399.0, 400.0, 401.0, 900.0])
    naive = [np.prod([1 - beta[i] for i in range(n) if ring[i] >= r]) for r in distances]
    np.testing.assert_allclose(transmission(radius, distances, n), naive, atol=1e-12)
    assert naive[0] == 0  # white in the middle
    assert naive[-2:] == [1, 1]


def test_effects_scale_with_the_frame_size() -> None:
    large, small = street(720), street(360)
    for gene in ("sun_flare", "smoke", "grid_dropout", "brightness", "gaussian_blur"):
        shrunk = cv2.resize(perturb(large, gene, 6, seed=8), (640, 360), interpolation=cv2.INTER_AREA)
        difference = np.abs(shrunk.astype(int) - perturb(small, gene, 6, seed=8)).mean()
        assert difference < 4, gene


BY_DIFFERENCE = [name for name in CATALOGUE if name not in ("grid_dropout", "rain")]
DRAWS = 6


@pytest.mark.parametrize("gene", mostly_long(BY_DIFFERENCE, BY_DIFFERENCE[::3], "tries every level"))
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
    """Return one minus the correlation of two blurred pictures."""
    smooth = [cv2.GaussianBlur(picture, (0, 0), sigma_px)[..., 1].ravel().astype(float) for picture in (a, b)]
    return float(1 - np.corrcoef(smooth[0], smooth[1])[0, 1])


@pytest.mark.long("averages many frames")
def test_larger_grid_holes_hide_more_at_the_same_total_area() -> None:
    frames = (street(720), blocks(720))
    levels = range(1, 9)
    holes = [(perturb(np.full_like(frames[0], 9), "grid_dropout", level) == 0).mean() for level in levels]
    assert holes == pytest.approx([0.25] * 8, abs=0.03)  # so the mean difference does not tell levels apart
    strength = [
        np.mean([unlike(perturb(f, "grid_dropout", level), f, 16.0) for f in frames]) for level in levels
    ]
    assert (np.diff(strength) > 0).all(), strength


@pytest.mark.long("averages many frames")
def test_rain_hides_more_from_drizzle_to_torrent_and_with_a_wet_lens() -> None:
    # The mean difference mostly measures the darkening, which is the same for every kind.
    drizzle, heavy, torrential, heavy_wet, torrential_wet = (
        np.mean(
            [unlike(perturb(street(360), "rain", level, seed=seed), street(360), 1.0) for seed in range(8)]
        )
        for level in range(1, 6)
    )
    assert drizzle < heavy < torrential < torrential_wet
    assert heavy < heavy_wet < torrential  # in the table, kind 4 is kind 2 with a wet lens, not kind 3
