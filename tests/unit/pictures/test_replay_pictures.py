"""Frames show the trace in the right places; files decode back to their frames."""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import ClassVar

import av
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image, ImageDraw, ImageSequence
from support.traces import make_trace

from brink.pictures import ReplayError, render, render_bytes
from brink.pictures.frame import FramePainter, Layout
from brink.pictures.map_view import Viewport
from brink.pictures.style import GHOST, SEEN_ON_PICTURE, VIOLATION, Rgb
from brink.pictures.timeline import timeline_figure, timeline_image
from brink.pictures.video import HOLD_S, film_samples, write_gif
from brink.sim.trace import Trace

SMALL = (640, 360)
HELD = round(HOLD_S * 10)
SHORT = 16


def count(image: Image.Image, colour: Rgb, box: Iterable[int] | None = None) -> int:
    part = image if box is None else image.crop(tuple(box))  # type: ignore[arg-type]
    return int((np.asarray(part) == colour).all(axis=2).sum())


@pytest.fixture(scope="module")
def trace() -> Trace:
    return make_trace()


@pytest.fixture(scope="module")
def painter(trace: Trace) -> FramePainter:
    return FramePainter(trace)


def test_frame_does_not_depend_on_the_frames_drawn_before(painter: FramePainter, trace: Trace) -> None:
    first = painter.frame(60).tobytes()
    painter.frame(120)
    assert painter.frame(60).tobytes() == first == FramePainter(trace).frame(60).tobytes()


def test_ghosts_are_drawn_while_they_are_perceived_and_only_then(painter: FramePainter) -> None:
    assert count(painter.map(60), GHOST) > 100
    assert count(painter.map(150), GHOST) == 0


def test_violation_is_marked_from_its_first_sample_on(painter: FramePainter) -> None:
    decisive = painter.story.decisive
    assert count(painter.map(decisive - 1), VIOLATION) == 0
    assert count(painter.map(decisive), VIOLATION) > 2000
    assert painter.verdict() == "violated the front gap at 17.5 s"


@pytest.mark.parametrize("size", [(639, 360), (640, 361), (320, 180), (1922, 1080)])
def test_frame_size_out_of_bounds_or_odd_is_rejected(trace: Trace, size: tuple[int, int]) -> None:
    with pytest.raises(ReplayError, match=f"size: expected even numbers.*got {size[0]}x{size[1]}"):
        FramePainter(trace, size=size)


@given(st.integers(320, 960), st.integers(180, 540))
def test_parts_of_a_frame_lie_inside_it_and_do_not_overlap(half_width: int, half_height: int) -> None:
    layout = Layout.of((2 * half_width, 2 * half_height))
    parts = [layout.header, layout.map, layout.camera, layout.panel, layout.time_bar]
    for index, (left, top, right, bottom) in enumerate(parts):
        assert 0 <= left < right <= layout.size[0]
        assert 0 <= top < bottom <= layout.size[1]
        for other in parts[index + 1 :]:
            assert right <= other[0] or other[2] <= left or bottom <= other[1] or other[3] <= top


@given(st.floats(-3, 3), st.lists(st.tuples(st.floats(-90, 90), st.floats(-90, 90)), min_size=2, max_size=9))
def test_map_preserves_distances_and_contains_the_drive(
    yaw: float, places: list[tuple[float, float]]
) -> None:
    ego = np.zeros((len(places), 5), np.float32)
    ego[:, :2], ego[:, 2] = places, yaw
    viewport = Viewport.along(np.empty((0, 2), np.float32), ego, px_per_m=8, margin_m=(20, 10))
    shown = viewport.to_px(ego[:, :2])
    assert (shown >= -1e-6).all()
    assert (shown <= np.array(viewport.size_px) + 1e-6).all()
    wanted = 8 * np.hypot(*(ego[0, :2] - ego[-1, :2]).astype(float))
    assert np.hypot(*(shown[0] - shown[-1])) == pytest.approx(wanted, abs=1e-3)
    ahead = viewport.to_px(np.array([[0.0, 0.0], [np.cos(yaw), np.sin(yaw)]]))
    np.testing.assert_allclose(ahead[1] - ahead[0], (8, 0), atol=1e-4)


def test_single_sample_without_road_users_is_drawn() -> None:
    trace = make_trace(samples=1)
    bare = replace(trace, actors=(), scene=(), route=np.empty((0, 2), np.float32), about={})
    for each in (trace, bare):
        image = np.asarray(FramePainter(each).frame(0))
        assert image.std() > 10
        assert np.asarray(timeline_image(each)).std() > 5


def test_timeline_shows_the_recorded_series(trace: Trace) -> None:
    speed, robustness, _ = timeline_figure(trace).axes
    target, actual = speed.lines[:2]
    np.testing.assert_array_equal(np.asarray(actual.get_ydata()), trace.ego[:, 3])
    np.testing.assert_array_equal(np.asarray(target.get_ydata()), trace.target_speed_mps)
    shown = np.asarray(robustness.lines[1].get_ydata(), dtype=float)
    recorded = trace.robustness["front-gap@1"]
    near = recorded < 10
    np.testing.assert_allclose(shown[near], recorded[near])
    assert robustness.get_ylim()[0] < recorded.min()
    assert list(np.asarray(robustness.lines[0].get_ydata())) == [0, 0]


@pytest.fixture(scope="module")
def short() -> Trace:
    return make_trace(samples=SHORT)


@pytest.fixture(scope="module")
def png(short: Trace) -> bytes:
    """The picture of the short drive."""
    return render_bytes(short, ".png")


def test_rendered_bytes_are_the_content_of_the_file(tmp_path: Path, short: Trace, png: bytes) -> None:
    assert render(short, tmp_path / "a.png").read_bytes() == png


def progress(total: int) -> list[tuple[int, int]]:
    """Return what is told while a file of so many frames is written."""
    return [(done, total) for done in range(1, total + 1)]


def test_gif_plays_every_sample_in_real_time(tmp_path: Path, short: Trace) -> None:
    told: list[tuple[int, int]] = []
    path = render(short, tmp_path / "a.gif", size=SMALL, on_progress=lambda done, of: told.append((done, of)))
    assert told == progress(SHORT + HELD)
    with Image.open(path) as film:
        assert film.size == SMALL
        lengths = [frame.info["duration"] for frame in ImageSequence.Iterator(film)]
        first = np.asarray(ImageSequence.Iterator(film)[0].convert("RGB")).astype(int)
    # Equal frames are one longer frame in a GIF.
    assert sum(lengths) == pytest.approx(100 * (SHORT + HELD))
    expected = np.asarray(FramePainter(short, size=SMALL).frame(0)).astype(int)
    assert np.abs(first - expected).mean() < 4


class Photographs:
    """A film of photographs on which a box is drawn."""

    size = SMALL
    time_s = np.array([0.0, 0.1])
    key_samples: ClassVar[list[int]] = [0]

    def frame(self, sample: int) -> Image.Image:
        rows, columns = np.mgrid[0 : SMALL[1], 0 : SMALL[0]]
        photograph = np.stack([columns % 256, rows % 256, (columns + rows) % 256], axis=2).astype(np.uint8)
        image = Image.fromarray(photograph)
        ImageDraw.Draw(image).rectangle((20, 20, 60, 90), outline=SEEN_ON_PICTURE)
        return image


def test_lines_on_photographs_keep_their_colour_in_a_gif(tmp_path: Path) -> None:
    write_gif(Photographs(), tmp_path / "a.gif")
    with Image.open(tmp_path / "a.gif") as film:
        assert film.convert("RGB").getpixel((20, 50)) == SEEN_ON_PICTURE


def test_mp4_plays_every_sample_in_real_time(tmp_path: Path, short: Trace) -> None:
    told: list[tuple[int, int]] = []
    path = render(
        short, tmp_path / "film.mp4", size=SMALL, on_progress=lambda done, of: told.append((done, of))
    )
    assert told == progress(SHORT + HELD)
    with av.open(str(path)) as film:
        stream = film.streams.video[0]
        assert stream.codec_context.name == "h264"
        assert stream.codec_context.pix_fmt == "yuv420p"
        assert stream.average_rate == 10
        frames = [frame.to_ndarray(format="rgb24") for frame in film.decode(video=0)]
    assert len(frames) == SHORT + HELD
    assert frames[0].shape == (360, 640, 3)
    painter = FramePainter(short, size=SMALL)
    for index in (0, 10, SHORT - 1):
        assert np.abs(frames[index].astype(int) - np.asarray(painter.frame(index))).mean() < 6
    assert path.read_bytes().index(b"moov") < path.read_bytes().index(b"mdat"), (
        "browsers want the index first"
    )


def test_film_follows_simulated_time_not_sample_numbers() -> None:
    trace = make_trace(samples=41)
    sparse = replace(trace, time_s=(np.arange(41) * 0.25).astype(np.float32))
    samples = film_samples(FramePainter(sparse, size=SMALL))
    assert len(samples) == 101 + HELD
    assert samples[:101] == [int(np.abs(sparse.time_s - i / 10 + 1e-6).argmin()) for i in range(101)]


@pytest.mark.parametrize(("name", "said"), [("film.avi", "'.avi'"), ("film", "'none'"), (".mp4", "'none'")])
def test_unknown_extension_gets_the_known_ones(tmp_path: Path, short: Trace, name: str, said: str) -> None:
    with pytest.raises(ReplayError, match=rf"extension: expected one of \.gif, \.mp4, \.png; got {said}"):
        render(short, tmp_path / name)
    assert list(tmp_path.iterdir()) == []


def test_failed_drawing_leaves_no_file(tmp_path: Path, short: Trace) -> None:
    class Stopped(Exception):
        pass

    def stop(done: int, total: int) -> None:
        if done == 3:
            raise Stopped

    for name in ("a.gif", "a.mp4"):
        with pytest.raises(Stopped):
            render(short, tmp_path / name, size=SMALL, on_progress=stop)
    assert list(tmp_path.iterdir()) == []


def test_trace_read_from_its_bytes_gives_the_same_picture(short: Trace, png: bytes) -> None:
    assert render_bytes(Trace.from_bytes(short.to_bytes()), ".png") == png
