"""Pictures and films decode back to what was asked for."""

import io
from dataclasses import replace
from pathlib import Path

import av
import numpy as np
import pytest
from PIL import Image, ImageSequence
from support.traces import make_trace

from brink.sim.replay import ReplayError, render, render_bytes, render_png_bytes
from brink.sim.replay.top_down import FramePainter
from brink.sim.replay.video import HOLD_S, film_samples
from brink.sim.trace import Trace

SMALL = (640, 360)
HELD = round(HOLD_S * 10)


@pytest.fixture(scope="module")
def trace() -> Trace:
    return make_trace(samples=40)


def test_png_is_as_wide_as_its_frame_and_has_strip_and_plots_below(tmp_path: Path, trace: Trace) -> None:
    path = render(trace, tmp_path / "story.PNG", size=SMALL)
    with Image.open(path) as image:
        image.load()
        assert image.format == "PNG"
        assert image.width == 640
        assert image.height > 1.6 * 360
        for top in range(0, image.height - 120, 120):
            assert np.asarray(image.convert("L").crop((0, top, 640, top + 120))).std() > 8


def test_png_bytes_are_the_file(tmp_path: Path, trace: Trace) -> None:
    path = render(trace, tmp_path / "a.png")
    assert render_png_bytes(trace) == path.read_bytes()


def test_gif_plays_every_sample_in_real_time(trace: Trace) -> None:
    with Image.open(io.BytesIO(render_bytes(trace, ".gif", size=SMALL))) as film:
        assert film.size == SMALL
        lengths = [frame.info["duration"] for frame in ImageSequence.Iterator(film)]
        first = np.asarray(ImageSequence.Iterator(film)[0].convert("RGB")).astype(int)
    # Equal frames are one longer frame in a GIF.
    assert sum(lengths) == pytest.approx(100 * (40 + HELD))
    expected = np.asarray(FramePainter(trace, size=SMALL).frame(0)).astype(int)
    assert np.abs(first - expected).mean() < 4


def test_mp4_plays_every_sample_in_real_time(tmp_path: Path, trace: Trace) -> None:
    path = render(trace, tmp_path / "film.mp4", size=SMALL)
    with av.open(str(path)) as film:
        stream = film.streams.video[0]
        assert stream.codec_context.name == "h264"
        assert stream.codec_context.pix_fmt == "yuv420p"
        assert stream.average_rate == 10
        frames = [frame.to_ndarray(format="rgb24") for frame in film.decode(video=0)]
    assert len(frames) == 40 + HELD
    assert frames[0].shape == (360, 640, 3)
    painter = FramePainter(trace, size=SMALL)
    for index in (0, 25, 39):
        assert np.abs(frames[index].astype(int) - np.asarray(painter.frame(index))).mean() < 6
    assert path.read_bytes().index(b"moov") < path.read_bytes().index(b"mdat"), (
        "browsers want the index first"
    )


@pytest.mark.parametrize(("name", "total"), [("a.gif", 40 + HELD), ("a.mp4", 40 + HELD), ("a.png", 1)])
def test_progress_counts_to_the_number_of_frames(tmp_path: Path, trace: Trace, name: str, total: int) -> None:
    seen: list[tuple[int, int]] = []
    render(trace, tmp_path / name, size=SMALL, on_progress=lambda done, of: seen.append((done, of)))
    assert seen == [(done, total) for done in range(1, total + 1)]


def test_film_follows_simulated_time_not_the_number_of_samples() -> None:
    trace = make_trace(samples=41)
    sparse = replace(trace, time_s=(np.arange(41) * 0.25).astype(np.float32))
    samples = film_samples(FramePainter(sparse, size=SMALL))
    assert len(samples) == 101 + HELD
    assert samples[:101] == [int(np.abs(sparse.time_s - i / 10 + 1e-6).argmin()) for i in range(101)]


@pytest.mark.parametrize(("name", "said"), [("film.avi", "'.avi'"), ("film", "'none'"), (".mp4", "'none'")])
def test_unknown_extension_is_refused_with_the_known_ones(
    tmp_path: Path, trace: Trace, name: str, said: str
) -> None:
    with pytest.raises(ReplayError, match=rf"extension: expected one of \.gif, \.mp4, \.png; got {said}"):
        render(trace, tmp_path / name)
    assert list(tmp_path.iterdir()) == []


def test_nothing_is_left_where_drawing_fails(tmp_path: Path, trace: Trace) -> None:
    class Stopped(Exception):
        pass

    def stop(done: int, total: int) -> None:
        if done == 3:
            raise Stopped

    for name in ("a.gif", "a.mp4"):
        with pytest.raises(Stopped):
            render(trace, tmp_path / name, size=SMALL, on_progress=stop)
    assert list(tmp_path.iterdir()) == []


def test_trace_survives_its_bytes_and_gives_the_same_picture(trace: Trace) -> None:
    assert render_png_bytes(Trace.from_bytes(trace.to_bytes())) == render_png_bytes(trace)
