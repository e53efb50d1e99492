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
from brink.sim.perturbations.lens import broken_lens, sun_flare, transmission
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


def flakes(level: int, seed: int) -> tuple[Frame, np.ndarray, np.ndarray]:
    """Return snow in the dark, how bright its flakes are above the veil, and the areas of the flakes in px."""
    snowy = perturb(grey(0), "snow", level, seed=seed)
    above = snowy[..., 0].astype(int) - int(np.median(snowy))
    _, _, stats, _ = cv2.connectedComponentsWithStats((above > 30).astype(np.uint8))
    return snowy, above, stats[1:, cv2.CC_STAT_AREA]


def test_snow_falls_at_several_depths_and_more_of_it_at_every_level() -> None:
    shares, counts = [], []
    for level in range(1, 6):
        _, above, areas = flakes(level, seed=0)
        shares.append((above > 30).mean())
        counts.append(len(areas))
        assert np.percentile(areas, 20) < 12
        assert areas.max() > 20 * np.median(areas), "few flakes are near"
    assert (np.diff(shares) > 0).all(), shares
    assert counts[0] > 300
    assert counts[2] > 2.5 * counts[0]


def test_all_flakes_fall_in_the_direction_of_the_wind() -> None:
    directions = []
    for seed in range(6):
        _, above, _ = flakes(1, seed)
        _, labels = cv2.connectedComponents((above > 30).astype(np.uint8))
        sizes = np.bincount(labels.ravel())
        angles = []
        for label in np.flatnonzero((sizes > 60) & (sizes < 400)).tolist():
            ys, xs = np.nonzero(labels == label)
            values, vectors = np.linalg.eigh(np.cov(xs, ys))
            if values[1] > 4 * values[0]:
                angles.append(np.arctan(vectors[0, 1] / vectors[1, 1]))
        assert len(angles) >= 30
        assert np.subtract(*np.percentile(angles, [75, 25])) < 0.3
        directions.append(np.median(angles))
    assert np.ptp(directions) > 0.3, "the wind differs from frame to frame"


@pytest.mark.parametrize("level", range(1, 6))
def test_settled_snow_and_the_veil_lighten_what_is_dark_and_lower_the_contrast(level: int) -> None:
    value = CATALOGUE["snow"].value(level)
    assert value is not None
    opacity = 0.5 * (value - 1) / 4
    for before in (0, 30, 60, 200, 240):  # below and above every threshold that may be drawn
        veil = min(215, 70 + 1.1 * before)
        settled = 0.25 * (min(255, value * before) - before) if before < 73 else 0
        expected = opacity * veil + (1 - opacity) * (before + settled)
        after = np.median(perturb(grey(before), "snow", level))
        assert after == pytest.approx(expected, abs=2)
    smooth = [cv2.GaussianBlur(f, (0, 0), 6) for f in (street(360), perturb(street(360), "snow", level))]
    assert smooth[1].std() < (1 - 0.6 * opacity) * smooth[0].std()


def test_snow_at_night_is_no_lighter_than_by_day() -> None:
    for level in (1, 3, 5):
        assert perturb(night(360), "snow", level).mean() < 0.6 * perturb(street(360), "snow", level).mean()


def test_rain_changes_more_from_drizzle_to_torrent_and_with_a_wet_lens() -> None:
    frame = grey(40)
    clear = 0.7 * 40
    wetted = []
    for level in range(1, 6):
        rainy = [perturb(frame, "rain", level, seed=seed).astype(float) for seed in range(2)]
        wetted.append(np.mean([np.abs(r - clear).mean() for r in rainy]))
        if level <= 3:
            background = np.mean([np.abs(r - clear).max(axis=2) <= 1 for r in rainy])
            assert background > 0.2  # pixels without drops are only darkened
    drizzle, heavy, torrential, heavy_wet, torrential_wet = wetted
    assert drizzle < heavy < torrential < torrential_wet
    assert heavy < heavy_wet


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


def test_smoke_is_densest_at_the_centre() -> None:
    whitened = np.mean(
        [perturb(grey(0, 180, 320), "smoke", 5, seed=seed)[..., 0] for seed in range(30)], axis=0
    )
    centre = whitened[70:110, 130:190].mean()
    assert centre > 2 * np.mean([whitened[:20, :40].mean(), whitened[-20:, -40:].mean()])


def test_flare_transmission_is_the_product_over_its_rings() -> None:
    n, radius = 40, 400.0
    ring = np.linspace(1, radius, n)
    beta = [(1 - i / (n - 1)) ** 3 for i in range(n)]
    distances = np.array([0.0, 0.5, 1.0, 50.0, 123.4, 200.0, 399.0, 400.0, 401.0, 900.0])
    naive = [np.prod([1 - beta[i] for i in range(n) if ring[i] >= r]) for r in distances]
    np.testing.assert_allclose(transmission(radius, distances, n), naive, atol=1e-12)
    assert naive[0] == 0  # white in the middle
    assert naive[-2:] == [1, 1]


def test_the_source_of_a_flare_lies_in_the_upper_half_and_ghosts_add_light() -> None:
    dark = grey(0, 180, 320)
    for seed in range(10):
        flared = sun_flare(dark, 400, np.random.default_rng(seed))
        ys, xs = np.nonzero((flared == 255).all(axis=2))
        assert ys.mean() <= 105, seed
        assert xs.size > 0


def test_a_broken_lens_only_brightens_and_its_cracks_reach_far() -> None:
    frame = grey(60)
    for seed in range(6):
        cracked = broken_lens(frame, 0.8, np.random.default_rng(seed))
        assert (cracked >= frame).all()
        hit = (cracked > 120).any(axis=2)
        assert 0.002 < hit.mean() < 0.2
        ys, xs = np.nonzero(hit)
        assert max(np.ptp(ys), np.ptp(xs)) > 300


def test_dirt_darkens_and_mist_lowers_contrast() -> None:
    bright = grey(220)
    for seed in range(2):
        dirtied = perturb(bright, "dirty", 10, seed=seed)
        assert (dirtied <= bright).all()
        assert 0.05 < (dirtied < 200).any(axis=2).mean() < 0.8
        misted = perturb(street(360), "condensation", 10, seed=seed)
        assert misted.std() < 0.8 * street(360).std()


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
