"""Writes the replay of an episode as a picture or a film, depending on the extension of the file."""

import os
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from brink.sim.replay.scene import ReplayError
from brink.sim.trace import Trace

DEFAULT_SIZES: Final = {".png": (1280, 720), ".gif": (800, 450), ".mp4": (960, 540)}
"""Width and height of a frame, by extension; a PNG has more below its frame."""


def render(
    trace: Trace,
    path: str | os.PathLike[str],
    *,
    requirement: str | None = None,
    size: tuple[int, int] | None = None,
    on_progress: Callable[[int, int], None] | None = None,
) -> Path:
    """Draw an episode into a file: a still picture (.png) or a film (.gif, .mp4).

    The file is written beside its place and then moved there, so it appears whole or not at all.

    Args:
        trace: The episode.
        path: The file; its extension decides what is drawn.
        requirement: Id of the requirement to judge; for the default see `story_of`.
        size: Width and height of a frame; by default a good one for the extension.
        on_progress: Called after each frame with the number of frames drawn and of all.

    Returns:
        The path.

    Raises:
        ReplayError: The extension is unknown, the size out of bounds, the trace empty or without the requirement.
        OSError: The file cannot be written.
    """
    # Figures and films take a second to load: only a caller who draws waits for them.
    from brink.sim.replay.frame import FramePainter
    from brink.sim.replay.sheets import still
    from brink.sim.replay.video import write_gif, write_mp4

    target = Path(path)
    extension = _known_extension(target.suffix)
    wanted = size or DEFAULT_SIZES[extension]
    partial = target.with_name(f".{target.name}.part")
    try:
        if extension == ".png":
            still(trace, requirement=requirement, size=wanted).save(partial, format="PNG")
            if on_progress is not None:
                on_progress(1, 1)
        else:
            painter = FramePainter(trace, requirement=requirement, size=wanted)
            (write_gif if extension == ".gif" else write_mp4)(painter, partial, on_progress)
        partial.replace(target)
    finally:
        partial.unlink(missing_ok=True)
    return target


def render_bytes(
    trace: Trace,
    extension: str,
    *,
    requirement: str | None = None,
    size: tuple[int, int] | None = None,
) -> bytes:
    """Draw an episode and return the content of the file.

    Args:
        trace: The episode.
        extension: Such as ``.mp4``.
        requirement: As for `render`.
        size: As for `render`.

    Raises:
        ReplayError: As for `render`.
    """
    with TemporaryDirectory(prefix="brink-replay-") as folder:
        path = Path(folder) / f"replay{_known_extension(extension)}"
        render(trace, path, requirement=requirement, size=size)
        return path.read_bytes()


def _known_extension(extension: str) -> str:
    found = extension.lower()
    if found not in DEFAULT_SIZES:
        known = ", ".join(sorted(DEFAULT_SIZES))
        raise ReplayError(f"extension: expected one of {known}; got {extension or 'none'!r}")
    return found
