"""Writes the replay of an episode as a still image or a video, depending on the file extension."""

import io
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Final

from brink.pictures.pair import DrivePair
from brink.pictures.scene import ReplayError
from brink.sim.trace import Trace

if TYPE_CHECKING:
    from PIL import Image

    from brink.pictures.video import Painter

MAP_COLOURS: Final = 128
DEFAULT_SIZES: Final = {".png": (1280, 720), ".gif": (800, 450), ".mp4": (960, 540)}
"""Width and height of a frame, by extension; a PNG shows more below its frame."""
PAIR_SIZES: Final = {".png": (1600, 900), ".gif": (960, 540), ".mp4": (1280, 720)}
"""The same for pairs; the size of a PNG depends on the pair."""


def render(
    trace: Trace,
    path: str | os.PathLike[str],
    *,
    requirement: str | Sequence[str] | None = None,
    size: tuple[int, int] | None = None,
    on_progress: Callable[[int, int], None] | None = None,
) -> Path:
    """Render an episode to a file: a still image (.png) or a video (.gif, .mp4).

    Where a reference driver would have avoided the violation, both drives are shown side by side.

    The file is written under a temporary name and then renamed, so it appears complete or not at all.

    Args:
        trace: The episode.
        path: The file; its extension decides the kind of replay.
        requirement: Ids of the requirements to judge; for the default see `story_of`.
        size: Width and height of a frame, without a reference driver's drive; the default depends on the extension.
        on_progress: Called after each frame with the number of frames drawn and the total.

    Returns:
        The path.

    Raises:
        ReplayError: The extension is unknown, the size out of bounds, the trace empty or without the requirement.
        OSError: The file cannot be written.
    """
    # These modules take a second to import, so they are imported only when an episode is rendered.
    from brink.pictures.frame import FramePainter
    from brink.pictures.reference import comparison_of
    from brink.pictures.sheets import still

    target = Path(path)
    compared = comparison_of(trace, requirement)
    if compared is not None and size is None:
        return render_pair(compared.pair(trace), target, on_progress=on_progress)
    wanted = size or DEFAULT_SIZES[_known_extension(target.suffix)]
    return _write(
        target,
        lambda: still(trace, requirement=requirement, size=wanted),
        lambda: FramePainter(trace, requirement=requirement, size=wanted),
        on_progress,
    )


def render_pair(
    pair: DrivePair, path: str | os.PathLike[str], *, on_progress: Callable[[int, int], None] | None = None
) -> Path:
    """Render a pair of drives to a file: a still image (.png) or a film of both side by side (.gif, .mp4).

    Args:
        pair: The pair.
        path: The file, written as by `render`.
        on_progress: Called after each frame with the number of frames drawn and the total.

    Returns:
        The path.

    Raises:
        ReplayError: The extension is unknown, a trace is empty or lacks the requirement.
        OSError: The file cannot be written.
    """
    from brink.pictures.pair_view import PairPainter, pair_still

    target = Path(path)
    size = PAIR_SIZES[_known_extension(target.suffix)]
    return _write(target, lambda: pair_still(pair), lambda: PairPainter(pair, size=size), on_progress)


def render_pair_maps(pair: DrivePair) -> tuple[bytes, bytes]:
    """Return both drives of a pair from above at the decisive moment, as PNG, in the order of display.

    Args:
        pair: The pair; its words are not shown.

    Raises:
        ReplayError: A trace is empty, or does not record the requirement.
    """
    from PIL import Image

    from brink.pictures.pair_view import pair_maps

    def encoded(picture: Image.Image) -> bytes:
        buffer = io.BytesIO()
        picture.quantize(MAP_COLOURS, dither=Image.Dither.NONE).save(buffer, format="PNG", optimize=True)
        return buffer.getvalue()

    first, second = pair_maps(pair)
    return encoded(first), encoded(second)


def _write(
    target: Path,
    still: "Callable[[], Image.Image]",
    painter: "Callable[[], Painter]",
    on_progress: Callable[[int, int], None] | None,
) -> Path:
    """Write a still image or a video, depending on the extension, under a temporary name, then rename it."""
    from brink.pictures.video import write_gif, write_mp4

    extension = _known_extension(target.suffix)
    partial = target.with_name(f".{target.name}.part")
    try:
        if extension == ".png":
            still().save(partial, format="PNG")
            if on_progress is not None:
                on_progress(1, 1)
        else:
            (write_gif if extension == ".gif" else write_mp4)(painter(), partial, on_progress)
        partial.replace(target)
    finally:
        partial.unlink(missing_ok=True)
    return target


def render_bytes(
    trace: Trace,
    extension: str,
    *,
    requirement: str | Sequence[str] | None = None,
    size: tuple[int, int] | None = None,
    on_progress: Callable[[int, int], None] | None = None,
) -> bytes:
    """Render an episode and return the content of the file.

    Args:
        trace: The episode.
        extension: Such as ``.mp4``.
        requirement: As for `render`.
        size: As for `render`.
        on_progress: As for `render`.

    Raises:
        ReplayError: As for `render`.
    """
    with TemporaryDirectory(prefix="brink-replay-") as folder:
        path = Path(folder) / f"replay{_known_extension(extension)}"
        render(trace, path, requirement=requirement, size=size, on_progress=on_progress)
        return path.read_bytes()


def _known_extension(extension: str) -> str:
    found = extension.lower()
    if found not in DEFAULT_SIZES:
        known = ", ".join(sorted(DEFAULT_SIZES))
        raise ReplayError(f"extension: expected one of {known}; got {extension or 'none'!r}")
    return found
