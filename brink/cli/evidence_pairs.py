"""The pairs of a campaign in the folder of `brink evidence`: tables, pictures, and a section of its README.md."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from brink.api.client import Api
from brink.api.results import UNDRAWABLE, FetchedArchive, read_all_pairs
from brink.report.pair_pictures import write_pair
from brink.report.tables import markdown_rows
from brink.search.errors import TooManyPairs
from brink.server.findings.pairs.table import pairs_table
from brink.server.findings.pairs.views import MOST_PAIRS, PairsView, PairView
from brink.server.findings.table import FORMATS, has_parquet
from brink.server.findings.words import as_sentence

_FOLDER: Final = "pairs"


@dataclass(frozen=True, slots=True, kw_only=True)
class PairEvidence:
    """The pairs of a campaign that searched for them.

    Attributes:
        view: The pairs.
        drawn: Pictures and films by the number of the pair, relative to the folder of the evidence.
        notes: Why pictures are missing.
    """

    view: PairsView
    drawn: Mapping[int, tuple[str, ...]]
    notes: tuple[str, ...]

    def files(self) -> list[str]:
        """Return the lines of README.md that describe each file."""
        if not self.view.pairs:
            return []
        tables = ", ".join(f"`pairs.{form}`" for form in FORMATS if form != "parquet" or has_parquet())
        lines = [
            f"- {tables}: one row per pair, with every parameter of both sides. Confirmed pairs come first."
        ]
        if self.drawn:
            lines.append(f"- `{_FOLDER}/pair-NUMBER.*`: both drives of a pair side by side.")
        return lines

    def section(self) -> str:
        """Return the section of README.md about the pairs, in Markdown."""
        view = self.view
        parts = [
            "# Pairs",
            f"{as_sentence(view.note)}. The two sides of a pair are at most {view.eps:g} apart, or one step; "
            f"distinct pairs are at least {view.d_th:g} apart.",
            *([view.caveat] if view.caveat else []),
        ]
        if not view.pairs:
            return "\n\n".join(parts)
        parts += [
            "\n".join(markdown_rows(pairs_table(view))),
            "\n".join(f"- {as_sentence(words)}." for words in view.legend),
            *(self._shown(pair) for pair in view.pairs if pair.place in self.drawn),
        ]
        return "\n\n".join(parts)

    def _shown(self, pair: PairView) -> str:
        """Return a pair with its picture."""
        told = [f"{as_sentence(pair.words)}."]
        if pair.common:
            told.append(f"In both: {pair.common}.")
        picture, *films = self.drawn[pair.place]
        told += [*pair.shown, *(f"[Film]({path})." for path in films)]
        return f"## Pair {pair.place}\n\n{' '.join(told)}\n\n![Pair {pair.place}]({picture})"


async def write_pair_tables(api: Api, fetched: FetchedArchive, folder: Path) -> PairEvidence | TooManyPairs:
    """Write the pairs of a campaign as tables, unless there is none.

    Args:
        api: Coordinator of the campaign.
        fetched: The campaign.
        folder: Folder to write to.

    Returns:
        The pairs without pictures, or that there are too many to tell apart.
    """
    view = await read_all_pairs(api, fetched.id)
    if isinstance(view, TooManyPairs):
        return view
    path = f"/campaigns/{fetched.id}/pairs"
    for form in FORMATS if view.pairs else ():
        if form != "parquet" or has_parquet():
            table = await api.request("GET", path, params={"limit": MOST_PAIRS, "format": form})
            (folder / f"pairs.{form}").write_bytes(table.content)
    return PairEvidence(view=view, drawn={}, notes=())


async def draw_pair_evidence(
    api: Api,
    evidence: PairEvidence,
    folder: Path,
    *,
    pictures: int,
    film: str | None,
    workers: bool,
    show: Callable[[str, int, int], None],
) -> PairEvidence:
    """Draw the pairs with the best evidence.

    Args:
        api: Coordinator of the campaign.
        evidence: The pairs.
        folder: Folder to write to.
        pictures: Most pairs to draw.
        film: ``gif`` or ``mp4`` to film them, too.
        workers: Whether the coordinator's workers run the drives again; otherwise this machine does.
        show: Called with what is being done, how much of it is done, and how much there is; 0 if that is unknown.

    Returns:
        The pairs with their pictures, and a note for each that could not be drawn.
    """
    view = evidence.view
    endings = ["png", *([film] if film and view.replayable else [])]
    drawn: dict[int, tuple[str, ...]] = {}
    notes = []
    for pair in view.pairs[:pictures]:
        (folder / _FOLDER).mkdir(exist_ok=True)
        names = tuple(f"{_FOLDER}/pair-{pair.place}.{ending}" for ending in endings)
        try:
            for name in names:
                await write_pair(api, view, pair, folder / name, workers=workers, show=show)
        except UNDRAWABLE as error:
            notes.append(f"pair {pair.place} has no picture: {type(error).__name__}: {error}")
            continue
        drawn[pair.place] = names
    return replace(evidence, drawn=drawn, notes=tuple(notes))
