"""Pictures and films that notebooks display, and that can be saved."""

import base64
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from brink.server.errors import InvalidInput

_MEDIA: Final = {".png": "image/png", ".gif": "image/gif", ".mp4": "video/mp4"}


@dataclass(frozen=True, slots=True, kw_only=True)
class Picture:
    """A picture or a film.

    Attributes:
        content: The file's content.
        suffix: ``.png``, ``.gif`` or ``.mp4``.
        words: What it shows.
    """

    content: bytes
    suffix: str
    words: str

    def __repr__(self) -> str:
        return f"<{self.words}: {_MEDIA[self.suffix]}, {len(self.content):,} bytes; save it with .save(path)>"

    def _repr_mimebundle_(self, include: Any = None, exclude: Any = None) -> dict[str, str]:
        """Return what a notebook displays: the picture, or a player."""
        encoded = base64.b64encode(self.content).decode()
        media = _MEDIA[self.suffix]
        bundle = {"text/plain": repr(self)}
        if self.suffix == ".mp4":
            bundle["text/html"] = (
                f'<video controls loop muted style="max-width:100%" src="data:{media};base64,{encoded}"></video>'
            )
        else:
            bundle[media] = encoded
        return bundle

    def save(self, path: str | Path) -> Path:
        """Write the file, and return its path.

        Args:
            path: Its name, which ends as the picture's kind does.

        Raises:
            InvalidInput: The name ends in something else.
        """
        target = Path(path)
        if target.suffix != self.suffix:
            raise InvalidInput.at("path", f"{path}: expected a file name that ends in {self.suffix}")
        partial = target.with_name(f"{target.name}.partial")
        partial.write_bytes(self.content)
        shutil.move(partial, target)
        return target
