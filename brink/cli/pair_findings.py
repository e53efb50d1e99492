"""The pairs at the end of `brink run`: first if the search was for pairs, otherwise in one line."""

import math
from pathlib import Path
from typing import Any, Final

from rich.console import Console
from rich.text import Text

from brink.api.client import Api
from brink.api.results import UNDRAWABLE, FetchedArchive, find_pair, read_all_pairs
from brink.cli.options import print_sentence
from brink.cli.pair_tables import pairs_table, print_legend
from brink.report.figures import Drawing
from brink.report.pair_pictures import write_pair
from brink.search.analysis.confirmation import Confirmation
from brink.search.errors import TooManyPairs
from brink.server.campaigns.body import DEFAULT_EPS, DEFAULT_PAIRS_D_TH
from brink.server.campaigns.follow_ups.kinds.confirm import DEFAULT_CONFIRMATIONS
from brink.server.campaigns.pairs import PairSettings
from brink.server.campaigns.plan import with_truth
from brink.server.errors import InvalidInput
from brink.server.findings.pairs.views import MOST_PAIRS, ComponentPart, PairsView, PairView
from brink.server.problems.catalogue import make_problem
from brink.server.problems.requirements import ANY

_PAIRS_SHOWN: Final = 5
_FORMATS: Final = ("jsonl", "csv")


class PairFindings:
    """The distinct pairs of a campaign.

    Args:
        view: The pairs.
        fetched: The campaign.
        tables: The pairs as files, by format.
    """

    name = "pairs"

    def __init__(self, view: PairsView, fetched: FetchedArchive, tables: dict[str, bytes]) -> None:
        self._view = view
        self._fetched = fetched
        self._tables = tables
        self._no_picture = ""
        self._replayable = view.replayable

    @property
    def view(self) -> PairsView:
        """The pairs."""
        return self._view

    @property
    def searched(self) -> bool:
        """Whether the campaign searched for pairs, so that they come first."""
        return self._view.searched

    def sentence(self) -> str:
        """Return the findings in one sentence."""
        return self._view.note

    def summary(self) -> dict[str, Any]:
        """Return the findings for ``brink run --json``; the pairs themselves are in the files."""
        return self._view.model_dump(
            mode="json", exclude={"pairs", "follow_ups", "offers", "name", "campaign"}
        )

    def show(self, screen: Console) -> None:
        """Print the first pairs if the search was for pairs, otherwise one line."""
        view = self._view
        if not self.searched:
            screen.print(f"pairs across the boundary: {view.note}", soft_wrap=True)
            return
        words, _, rest = view.note.partition("; ")
        print_sentence(screen, Text.assemble((words, "bold"), f"; {rest}" if rest else ""))
        if view.pairs:
            what = "solutions" if view.computed else "drives"
            screen.print(
                f"a pair is two neighbouring {what}, one safe and one unsafe; it says how far each number moved",
                soft_wrap=True,
                style="dim",
            )
            screen.print(pairs_table(view, _PAIRS_SHOWN))
            if view.distinct > _PAIRS_SHOWN:
                screen.print(f"… and {view.distinct - _PAIRS_SHOWN} more in pairs.csv", style="dim")
            print_legend(screen, view)
        for words in filter(None, (view.blame, *view.chance)):
            print_sentence(screen, words)
        if self._no_picture:
            screen.print(self._no_picture, soft_wrap=True, style="yellow")

    def write(self, folder: Path) -> list[Path]:
        """Write the pairs to files, unless there are none; return the files."""
        files = []
        for form, table in self._tables.items():
            files.append(folder / f"pairs.{form}")
            files[-1].write_bytes(table)
        return files

    def differs_from(self, file: Path) -> bool:
        """Return whether a file that `write` wrote is out of date."""
        return file.read_bytes() != self._tables.get(file.suffix.removeprefix("."), b"")

    async def draw(self, drawing: Drawing) -> list[Path]:
        """Draw the pair with the best evidence if the search was for pairs; return the files.

        If an earlier run drew another one, that is drawn again, because there may be new evidence for it.
        """
        if not self.searched or not self._view.pairs or drawing.stop.is_set():
            return []
        chosen = [self._view.pairs[0]]
        first = find_pair(self._view, 1)
        if first is not None and first != chosen[0] and _file_of(drawing, first).is_file():
            chosen.append(first)
        files = []
        for pair in chosen:
            try:
                # Not by workers: after --resume of a finished campaign there is none.
                self._replayable = await write_pair(
                    drawing.api, self._view, pair, _file_of(drawing, pair), workers=False, show=drawing.show
                )
            except UNDRAWABLE as error:
                self._no_picture = f"no picture of pair {pair.place}: {error}"
                self._replayable = False
                break
            files.append(_file_of(drawing, pair))
        return files

    def hints(self, campaign: str, database: str) -> list[tuple[str, str]]:
        """Return commands to suggest to the user next, each with its purpose."""
        view = self._view
        if not view.pairs:
            if not self.searched or view.nearest is None:
                return []
            wider = f"pairs {campaign} --eps {_rounded_up(view.nearest.distance)}{database}"
            return [(wider, "see the nearest ones; a larger budget.simulations finds nearer ones")]
        if not self.searched:
            return [(f"pairs {campaign}{database}", "see its pairs: what changes a verdict")]
        hints = []
        untried = any(pair.confirmation.state is Confirmation.NOT_TRIED for pair in view.pairs)
        unasked = any(pair.component.state is ComponentPart.NOT_TRIED for pair in view.pairs)
        options = [
            *([f"--confirm {DEFAULT_CONFIRMATIONS}"] if untried and not view.computed else []),
            *(["--component"] if unasked and _has_component(self._fetched) else []),
        ]
        if options:
            what = "see which pairs hold with other seeds"
            if options[-1] == "--component":
                what = "do they hold with other seeds, and is the component to blame?"
            hints.append((f"pairs {campaign} {' '.join(options)}{database}", what))
        if not view.computed and len(view.pairs) > 1 and not self._no_picture:
            other = view.pairs[1].place
            hints.append(
                (f"pairs {campaign} --picture {other} pair-{other}.png{database}", "see another pair")
            )
        if self._replayable:
            best = view.pairs[0].place
            hints.append(
                (f"pairs {campaign} --film {best} pair-{best}.mp4{database}", "watch both drives of a pair")
            )
        return hints

    def decides_by_some_requirements(self) -> bool:
        """Return whether the problem could also use further requirements, with ``requirement: any``."""
        problem = self._fetched.plan.problem
        if not problem.requirements:
            return False
        params = {**self._fetched.plan.body.problem.params, "requirement": ANY}
        try:
            every = make_problem(problem.id, params)
        except InvalidInput:
            return False
        return not set(every.requirements) <= set(problem.requirements)


def _file_of(drawing: Drawing, pair: PairView) -> Path:
    return drawing.folder / f"pair-{pair.place}.png"


def _rounded_up(distance: float) -> str:
    """Return a distance in (0, 1] rounded up to two digits, as text."""
    unit = 10.0 ** (math.floor(math.log10(distance)) - 1)
    return f"{min(1.0, math.ceil(distance / unit) * unit):.2g}"


def _has_component(fetched: FetchedArchive) -> bool:
    try:
        with_truth(fetched.plan.problem)
    except InvalidInput:
        return False
    return True


class TooManyFindings:
    """The findings of a campaign with too many pairs to tell apart.

    Args:
        refusal: Why its pairs are not listed.
        fetched: The campaign.
    """

    def __init__(self, refusal: TooManyPairs, fetched: FetchedArchive) -> None:
        self._refusal = refusal
        self._fetched = fetched

    @property
    def view(self) -> TooManyPairs:
        """Why there is no list of pairs."""
        return self._refusal

    @property
    def searched(self) -> bool:
        """Whether the campaign searched for pairs."""
        return self._fetched.plan.is_for("pairs")

    def summary(self) -> dict[str, Any]:
        """Return why there are no findings for ``brink run --json``."""
        return {"searched": self.searched, "too_many": str(self._refusal)}

    def show(self, screen: Console) -> None:
        """Print why there is no pair, in one line."""
        screen.print(f"no list of pairs: {self._refusal}", soft_wrap=True, style="yellow")

    def write(self, folder: Path) -> list[Path]:
        """Write nothing."""
        return []

    async def draw(self, drawing: Drawing) -> list[Path]:
        """Draw nothing."""
        return []

    def hints(self, campaign: str, database: str) -> list[tuple[str, str]]:
        """Return the command that lists fewer pairs."""
        own = PairSettings.of(self._fetched.plan)
        if self._refusal.setting == "d_th":
            option, value = "--d-th", min(1.0, max(DEFAULT_PAIRS_D_TH, 2 * own.d_th))
        else:
            option, value = "--eps", min(DEFAULT_EPS, own.eps / 2)
        return [(f"pairs {campaign} {option} {value:g}{database}", "list fewer pairs")]


async def fetch_pair_findings(api: Api, fetched: FetchedArchive) -> PairFindings | TooManyFindings:
    """Return the distinct pairs of a campaign, and their files, or a note that there are too many."""
    view = await read_all_pairs(api, fetched.id)
    if isinstance(view, TooManyPairs):
        return TooManyFindings(view, fetched)
    path = f"/campaigns/{fetched.id}/pairs"
    tables = {}
    for form in _FORMATS if view.pairs else ():
        table = await api.request("GET", path, params={"limit": MOST_PAIRS, "format": form})
        tables[form] = table.content
    return PairFindings(view, fetched, tables)
