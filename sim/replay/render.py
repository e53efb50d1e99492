"""The one door to replays: a trace becomes a picture or a film, by the extension of the file."""

import os
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from brink.sim.replay.errors import ReplayError
from brink.sim.replay.layout import DEFAULT_SIZE, Size
from brink.sim.replay.progress import Progress
from brink.sim.trace import Trace

DEFAULT_SIZES: Final[dict[str, Size]] = {".png": (1280, 720), ".gif": (800, 450), ".mp4": DEFAULT_SIZE}
"""Size of the frames of each kind of file; a PNG has more below its frame."""


def render(
    trace: Trace,
    path: str | os.PathLike[str],
    *,
    requirement: str | None = None,
    size: Size | None = None,
    on_progress: Progress | None = None,
) -> Path:
    """Draw an episode into a file: a still picture (.png) or a film (.gif, .mp4).

    The file appears whole or not at all: it is written beside its place and then moved there.

    Args:
        trace: The episode.
        path: Where to; its extension decides what is drawn.
        requirement: Id of the requirement to judge; the front gap, or the first of the trace, if not given.
        size: Width and height of a frame; a good one for the kind of file if not given.
        on_progress: Called with the number of frames done and of all.

    Returns:
        The path.

    Raises:
        ReplayError: The extension is unknown, the size out of bounds, the trace empty or without the requirement.
        OSError: The file cannot be written.
    """
    # Figures and films take a second to load: only those who draw wait for it.
    from brink.sim.replay.still import still
    from brink.sim.replay.top_down import FramePainter
    from brink.sim.replay.video import write_gif, write_mp4

    target = Path(path)
    kind = _kind(target.suffix)
    wanted = size or DEFAULT_SIZES[kind]
    partial = target.with_name(f".{target.name}.part")
    try:
        if kind == ".png":
            still(trace, requirement=requirement, size=wanted).save(partial, format="PNG")
            if on_progress is not None:
                on_progress(1, 1)
        else:
            painter = FramePainter(trace, requirement=requirement, size=wanted)
            (write_gif if kind == ".gif" else write_mp4)(painter, partial, on_progress)
        partial.replace(target)
    finally:
        partial.unlink(missing_ok=True)
    return target


def render_bytes(
    trace: Trace,
    extension: str,
    *,
    requirement: str | None = None,
    size: Size | None = None,
    on_progress: Progress | None = None,
) -> bytes:
    """Draw an episode and return the file's content; for arguments and errors see `render`."""
    with TemporaryDirectory(prefix="brink-replay-") as folder:
        path = Path(folder) / f"replay{_kind(extension)}"
        render(trace, path, requirement=requirement, size=size, on_progress=on_progress)
        return path.read_bytes()


def render_png_bytes(trace: Trace, *, requirement: str | None = None, size: Size | None = None) -> bytes:
    """Return the still picture of an episode as PNG; for arguments and errors see `render`."""
    return render_bytes(trace, ".png", requirement=requirement, size=size)


def _kind(extension: str) -> str:
    kind = extension.lower()
    if kind not in DEFAULT_SIZES:
        known = ", ".join(sorted(DEFAULT_SIZES))
        raise ReplayError(f"extension: expected one of {known}; got {extension or 'none'!r}")
    return kind
