"""What a campaign found beyond the boundary, as the end of a run sees it."""

from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

from rich.console import Console

from brink.api.client import Api
from brink.cli.draw import FetchedArchive
from brink.cli.findings.combinations import fetch_combinations
from brink.cli.findings.drawing import Drawing
from brink.cli.findings.violations import fetch_violations


class Findings(Protocol):
    """One kind of findings.

    Attributes:
        name: In a word.
    """

    name: str

    def sentence(self) -> str:
        """Return it in a sentence."""
        ...

    def show(self, screen: Console) -> None:
        """Print it for people."""
        ...

    def write(self, folder: Path) -> list[Path]:
        """Write it to files."""
        ...

    async def draw(self, drawing: Drawing) -> list[Path]:
        """Draw it, as far as traces can be had."""
        ...

    def hints(self, campaign: str, database: str) -> list[tuple[str, str]]:
        """Return commands to go on with, and what each is for."""
        ...


async def fetch_findings(api: Api, fetched: FetchedArchive) -> Sequence[Findings]:
    """Return all kinds of findings that a campaign's problem has."""
    found = [await fetch_combinations(api, fetched), await fetch_violations(api, fetched)]
    return [one for one in found if one is not None]
