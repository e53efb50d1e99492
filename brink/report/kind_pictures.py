"""Pictures and sentences that a report has for only one kind of finding.

`PICTURES` is the only place in reports that knows kinds by name.
"""

import asyncio
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Final

from brink.api.client import Api, CoordinatorError
from brink.api.results import UNDRAWABLE, read_all_pairs
from brink.report.campaign_facts import Facts
from brink.report.campaign_sections import Album, Article, Section
from brink.report.combinations import draw_chains
from brink.report.comparison import compared_archives
from brink.report.figures import Drawing, campaign_figure, write_replays
from brink.report.limits import MOST_PAIRS
from brink.report.pair_pictures import write_pair
from brink.report.rate import draw_rate
from brink.report.thresholds import draw_thresholds
from brink.report.violations import draw_gallery
from brink.search.analysis.comparison import control_summaries
from brink.search.errors import TooManyPairs
from brink.server.campaigns.body import DEFAULT_D_TH, DEFAULT_T_B
from brink.server.findings.boundary.views import Boundary
from brink.server.findings.combinations.views import Combinations
from brink.server.findings.finding import Finding, Role, Term
from brink.server.findings.pairs.views import PairsView, PairView, SideView
from brink.server.findings.pairs.words import extent_words
from brink.server.findings.tolerances.views import ToleranceView
from brink.server.findings.violations.views import TypeView, Violations
from brink.server.findings.words import as_sentence, counted

OTHERS_PAIRS: Final = 2
"""Maximum number of pairs drawn if the search had another purpose."""
TYPES_DRAWN: Final = 4
CHAINS_DRAWN: Final = 1
"""A chain and its parts are up to six drives with a camera, each of which takes as long as in the search."""
REPLAYS_DRAWN: Final = 2
_AT_ONCE: Final = 2


class KindPictures:
    """What only one kind of finding has in a report: by default, nothing.

    Args:
        facts: The facts about the campaign.
        finding: Its finding of the kind.
        most_pairs: Most pairs to show in full.

    Attributes:
        trust: How far the finding can be trusted, where only the report states it.
        elsewhere: What random search found with the same settings, in words; empty if that is unknown.
    """

    def __init__(self, facts: Facts, finding: Finding, most_pairs: int) -> None:
        self._facts = facts
        self._finding = finding
        self._most_pairs = most_pairs
        self.trust: list[Term] = []
        self.elsewhere = ""

    async def read(self, api: Api, path: str) -> None:
        """Read what is drawn.

        Args:
            api: Coordinator of the campaign.
            path: Path of the campaign in the API.
        """

    async def draw(self, drawing: Drawing) -> Sequence[Path]:
        """Draw the pictures; return the files of those that could be drawn."""
        return []

    def illustrate(self, section: Section, album: Album) -> Section:
        """Return the section of the finding with its pictures."""
        return section

    def draw_map(self, file: Path) -> None:
        """Draw the map of a campaign that is for this kind."""
        draw_map(self._facts, None, file)


def draw_map(facts: Facts, pairs: PairsView | None, file: Path) -> None:
    """Draw the map of a campaign, with rings around the sides of pairs, or around boundary solutions without any."""
    figure = campaign_figure("map", facts.fetched, t_b=DEFAULT_T_B, d_th=DEFAULT_D_TH, pairs=pairs)
    figure.savefig(file, metadata={"Software": None})


class _Pairs(KindPictures):
    """The first pairs in full, each with a picture of both sides."""

    _view: PairsView | None = None

    async def read(self, api: Api, path: str) -> None:
        pairs = await read_all_pairs(api, self._facts.view.id)
        self._view = None if isinstance(pairs, TooManyPairs) else pairs
        if self._view is not None and self._finding.role is Role.SOUGHT:
            for one in self._facts.random[:1]:
                self.elsewhere = await _distinct_pairs(api, one.id, self._view)

    def _shown(self) -> Sequence[PairView]:
        if self._view is None:
            return []
        most = self._most_pairs
        return self._view.pairs[: most if self._finding.role is Role.SOUGHT else min(most, OTHERS_PAIRS)]

    async def draw(self, drawing: Drawing) -> Sequence[Path]:
        """Draw pairs, several at once."""
        slots, done, pairs = asyncio.Semaphore(_AT_ONCE), 0, self._shown()

        async def draw(pair: PairView) -> Path | None:
            nonlocal done
            path = drawing.folder / f"pair-{pair.place}.png"
            async with slots:
                try:
                    assert self._view is not None
                    await write_pair(drawing.api, self._view, pair, path, workers=drawing.workers)
                except UNDRAWABLE:
                    return None
                finally:
                    done += 1
                    drawing.show("drawing pairs", done, len(pairs))
            return path

        if pairs:
            drawing.show("drawing pairs", 0, len(pairs))
        return [path for path in await asyncio.gather(*map(draw, pairs)) if path is not None]

    def illustrate(self, section: Section, album: Album) -> Section:
        return replace(section, articles=[self._article(pair, album) for pair in self._shown()])

    def _article(self, pair: PairView, album: Album) -> Article:
        noun = self._facts.noun
        words = f"Pair {pair.place}: both {noun}s side by side. {pair.words}"
        picture = album(f"pair-{pair.place}.png", words)
        return Article(
            title=f"Pair {pair.place}: {as_sentence(pair.change)}",
            common=f"In both: {pair.common}" if pair.common else "",
            safe=_side_words(noun, pair.safe),
            unsafe=_side_words(noun, pair.unsafe),
            chips=[*pair.evidence, *filter(None, (extent_words(pair), pair.moved))],
            sentences=[*pair.shown, *pair.facts],
            picture=picture[0] if picture else None,
        )

    def draw_map(self, file: Path) -> None:
        draw_map(self._facts, self._view, file)


async def _distinct_pairs(api: Api, campaign: str, view: PairsView) -> str:
    """Return how many pairs another campaign found with the same settings; empty if there are too many."""
    params = {"limit": 1, "eps": view.eps, "d_th": view.d_th}
    try:
        there = await api.read(PairsView, f"/campaigns/{campaign}/pairs", params)
    except CoordinatorError:
        return ""
    return counted(there.distinct, "distinct pair")


def _side_words(noun: str, side: SideView) -> str:
    """Return what happened in a drive, and how often it was unsafe when it was simulated again."""
    return ". ".join(filter(None, (f"{noun} {side.number}: {side.outcome}", as_sentence(side.again))))


class _Tolerances(KindPictures):
    """The share of drives that violate because of each error, against its severity."""

    _view: ToleranceView

    async def read(self, api: Api, path: str) -> None:
        self._view = await api.read(ToleranceView, f"{path}/tolerance")

    async def draw(self, drawing: Drawing) -> Sequence[Path]:
        # matplotlib takes half a second to load: only what draws waits for it.
        from brink.plots.tolerance import figure_tolerance

        drawing.show("drawing curves", 0, 0)
        file = drawing.folder / "tolerance.png"
        await asyncio.to_thread(figure_tolerance(self._view).savefig, file)
        return [file]

    def illustrate(self, section: Section, album: Album) -> Section:
        words = "Share of drives that violate because of an error, against the severity of the error"
        return replace(section, pictures=album("tolerance.png", words))


class _Rate(KindPictures):
    """The interval of the rate against simulations."""

    async def draw(self, drawing: Drawing) -> Sequence[Path]:
        if self._finding.view is None:
            return []
        file = drawing.folder / "rate.png"
        await asyncio.to_thread(draw_rate, self._finding, file)
        return [file]

    def illustrate(self, section: Section, album: Album) -> Section:
        return replace(section, pictures=album("rate.png", "The interval of the rate as simulations came in"))


class _Thresholds(KindPictures):
    """How likely a violation is along the unit of each threshold."""

    async def draw(self, drawing: Drawing) -> Sequence[Path]:
        if self._finding.view is None:
            return []
        drawing.show("drawing thresholds", 0, 0)
        file = drawing.folder / "thresholds.png"
        await asyncio.to_thread(draw_thresholds, self._finding, file)
        return [file]

    def illustrate(self, section: Section, album: Album) -> Section:
        words = (
            "Probability of a violation along one number, with every drive that says so; grey: from 20 to 80%"
        )
        return replace(section, pictures=album("thresholds.png", words))


class _Violations(KindPictures):
    """An example of each of the first types of violations."""

    _view: Violations

    async def read(self, api: Api, path: str) -> None:
        self._view = await api.read(Violations, f"{path}/violations")

    async def draw(self, drawing: Drawing) -> Sequence[Path]:
        drawing.show("drawing violations", 0, 0)
        return await draw_gallery(self._view, drawing, TYPES_DRAWN)

    def illustrate(self, section: Section, album: Album) -> Section:
        types = self._view.types
        pictures = [
            picture
            for place, kind in enumerate(types, start=1)
            if kind.example
            not in {one.example for one in types[: place - 1]}  # one drive may have several types
            for picture in album(f"violation-{place}.png", f"Drive {kind.example}: {_avoidable_type(kind)}")
        ]
        return replace(section, gallery=pictures[:TYPES_DRAWN])


def _avoidable_type(kind: TypeView) -> str:
    """Return a type and who would have avoided it."""
    return kind.type if kind.avoidable is None else f"{kind.type}; {kind.avoidable.words}"


class _Combinations(KindPictures):
    """A chain of techniques beside its parts, in the same street with the same seed."""

    _view: Combinations

    async def read(self, api: Api, path: str) -> None:
        self._view = await api.read(Combinations, f"{path}/combinations")

    async def draw(self, drawing: Drawing) -> Sequence[Path]:
        drawing.show("drawing combinations", 0, 0)
        return await draw_chains(self._view, drawing, CHAINS_DRAWN)

    def illustrate(self, section: Section, album: Album) -> Section:
        words = "A chain of changes beside its parts, in the same street with the same seed"
        pictures = [
            picture
            for place, name in enumerate(album.named("combination-"), start=1)
            for picture in album(name, f"{words} ({place})")
        ]
        return replace(section, pictures=pictures)


class _Boundary(KindPictures):
    """Replays of the best boundary solutions of a search for the boundary, and the comparison with its control."""

    _numbers: Mapping[int, str]

    async def read(self, api: Api, path: str) -> None:
        params = {"t_b": DEFAULT_T_B, "d_th": DEFAULT_D_TH}
        solutions = (await api.read(Boundary, f"{path}/boundary", params)).solutions
        if self._finding.role is not Role.SOUGHT:
            solutions = []
        simulated = [one for one in solutions if one.spec is not None]
        self._numbers = {one.number: one.outcome or str(one.verdict) for one in simulated[:REPLAYS_DRAWN]}
        if self._finding.role is Role.SOUGHT:
            compared = compared_archives([self._facts.fetched], control=True)
            if told := " ".join(f"{one}." for one in control_summaries(compared, DEFAULT_T_B, DEFAULT_D_TH)):
                words = f"{told} A control shows what scenarios and chance alone explain."
                self.trust = [Term(term="Control", words=words)]

    async def draw(self, drawing: Drawing) -> Sequence[Path]:
        if not self._numbers:
            return []
        drawing.show("drawing replays", 0, 0)
        return await write_replays(drawing, list(self._numbers))

    def illustrate(self, section: Section, album: Album) -> Section:
        gallery = [
            picture
            for number, outcome in self._numbers.items()
            for picture in album(f"replay-{number}.png", f"Boundary solution {number}: {outcome}")
        ]
        return replace(section, gallery=gallery)


PICTURES: Final[Mapping[str, type[KindPictures]]] = {
    "pairs": _Pairs,
    "rate": _Rate,
    "thresholds": _Thresholds,
    "tolerances": _Tolerances,
    "violations": _Violations,
    "combinations": _Combinations,
    "boundary": _Boundary,
}


async def read_pictures(api: Api, facts: Facts, most_pairs: int = MOST_PAIRS) -> Mapping[str, KindPictures]:
    """Return what only some kinds of findings have, for those that a report shows, by kind.

    Args:
        api: Coordinator of the campaign.
        facts: The facts about the campaign.
        most_pairs: Most pairs to show in full.
    """
    found = {one.kind: one for one in facts.found}
    pictures = {
        kind: PICTURES.get(kind, KindPictures)(facts, finding, most_pairs) for kind, finding in found.items()
    }
    for one in pictures.values():
        await one.read(api, f"/campaigns/{facts.view.id}")
    return pictures


async def draw_pictures(
    drawing: Drawing, facts: Facts, pictures: Mapping[str, KindPictures]
) -> Mapping[str, Path]:
    """Draw the pictures of a report; return those that could be drawn, by file name.

    Args:
        drawing: The campaign and the folder.
        facts: The facts about the campaign.
        pictures: Those of its kinds of findings.
    """
    files = [file for one in pictures.values() for file in await one.draw(drawing)]
    if facts.evaluated and not facts.finding.exclusive:
        drawing.show("drawing the map", 0, 0)
        files.append(drawing.folder / "map.png")
        first = pictures.get(facts.finding.findings[0].kind)
        draw = partial(draw_map, facts, None) if first is None else first.draw_map
        await asyncio.to_thread(draw, files[-1])
    if facts.detector is not None:
        from brink.plots.detector import figure_detector

        files.append(drawing.folder / "detector.png")
        await asyncio.to_thread(figure_detector(facts.detector).savefig, files[-1])
    return {file.name: file for file in files}
