"""The sections of a campaign's report about its result: pairs, tolerances, violations, the boundary, outcomes."""

import base64
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from PIL import Image

from brink.report.campaign_facts import Facts
from brink.report.campaign_pictures import shown_replays
from brink.report.campaign_words import boundary_words, count, limiting, noun, others_recorded, share
from brink.report.combinations import CLAIMS, added_harm_words, claim_words, tally_words, variant_words
from brink.report.detector import COLUMNS, NUMBERS, evidence, row_of, small_print
from brink.report.pair_pictures import facts as pair_facts
from brink.report.pair_pictures import findings as pair_findings
from brink.report.pair_pictures import share_words
from brink.report.pair_words import common_words, evidence_words, extent_words, legend
from brink.report.tolerance import KEY, tolerated_words
from brink.search.analysis.combinations import HAZARDOUS, MIN_PLACES
from brink.search.analysis.rules import LEAST_LEAF, USELESS
from brink.search.errors import TooManyPairs
from brink.server.findings.boundary.views import Boundary
from brink.server.findings.follow_ups import ShareView
from brink.server.findings.pairs.views import PairsView, PairView, SideView
from brink.server.findings.tolerances.views import ToleranceView, Tolerated
from brink.server.findings.violations.views import TypeView
from brink.server.problems.changes import as_sentence
from brink.server.states import OutcomeKind

MOST_ROWS: Final = 20
MOST_RULES: Final = 4
MOST_GALLERY: Final = 4
LARGE_BYTES: Final = 1_000_000
JPEG_QUALITY: Final = 88

_KINDS: Final = {
    OutcomeKind.HELD: "safe",
    OutcomeKind.OTHER: "safe, another requirement violated",
    OutcomeKind.VIOLATED: "unsafe",
}


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture on the page."""

    source: str
    words: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """A table on the page.

    Attributes:
        label: What it shows, for people who do not see it.
        columns: Headers.
        rows: Cells as text.
        right: Indexes of the columns with numbers.
        more: What was left out, in words; empty if nothing was.
    """

    label: str
    columns: Sequence[str]
    rows: Sequence[Sequence[str]]
    right: Sequence[int] = ()
    more: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class ShownPair:
    """A pair that the page shows in full."""

    place: int
    change: str
    common: str
    safe: str
    unsafe: str
    evidence: Sequence[str]
    sentences: Sequence[str]
    picture: Picture | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Section:
    """A section of the page; its parts are shown in the order of the attributes.

    Attributes:
        title: Heading.
        paragraphs: What it says.
        pairs: Pairs that are shown in full.
        pictures: Pictures as wide as the page.
        gallery: Smaller pictures side by side, with their words below.
        lists: Headings with sentences.
        tables: Tables.
    """

    title: str
    paragraphs: Sequence[str] = ()
    pairs: Sequence[ShownPair] = ()
    pictures: Sequence[Picture] = ()
    gallery: Sequence[Picture] = ()
    lists: Sequence[tuple[str, Sequence[str]]] = ()
    tables: Sequence[Table] = ()


class Album:
    """The pictures of a report, as data URIs."""

    def __init__(self, files: Mapping[str, Path]) -> None:
        self._files = files

    def __call__(self, name: str, words: str) -> list[Picture]:
        """Return a picture with a description by its file name; empty if there is none."""
        file = self._files.get(name)
        if file is None or not file.is_file():
            return []
        kind, data = _smaller(file)
        return [Picture(f"data:image/{kind};base64,{base64.b64encode(data).decode()}", words)]

    def named(self, prefix: str) -> list[str]:
        """Return the file names that begin with a prefix, by their numbers."""
        found = [name for name in self._files if name.startswith(prefix)]
        return sorted(found, key=lambda name: (len(name), name))


def _smaller(file: Path) -> tuple[str, bytes]:
    """Return the format and the data of a picture; camera images, whose PNG is large, become JPEG."""
    data = file.read_bytes()
    if len(data) <= LARGE_BYTES:
        return "png", data
    buffer = io.BytesIO()
    with Image.open(io.BytesIO(data)) as opened:
        opened.convert("RGB").save(buffer, "JPEG", quality=JPEG_QUALITY)
    return ("jpeg", buffer.getvalue()) if buffer.tell() < len(data) else ("png", data)


def pairs_section(facts: Facts, album: Album, full: Sequence[PairView]) -> Section | None:
    """Return the pairs, some of them in full; None if there are none.

    Args:
        facts: What is known of the campaign.
        album: Its pictures.
        full: The pairs to show in full.
    """
    pairs = facts.pairs
    if isinstance(pairs, TooManyPairs):
        return None
    rest = _rest(facts, pairs, full)
    if not full and rest is None:
        return None
    many = f"{noun(facts)}s"
    told = [
        f"A pair is two {many} on either side of the boundary, at most {pairs.eps:g} apart on average over all "
        "parameters (in [0, 1]), or one step: one number may still move far, and each pair says how far. "
        f"Pairs that are at least {pairs.d_th:g} apart count as distinct.",
        *(f"{as_sentence(words)}." for words in legend(pairs)),
    ]
    return Section(
        title=_pairs_title(facts, pairs),
        pairs=[_shown_pair(facts, pairs, pair, album) for pair in full],
        lists=[("How to read pairs", told)],
        tables=[] if rest is None else [rest],
    )


def _pairs_title(facts: Facts, pairs: PairsView) -> str:
    if not facts.searched_pairs:
        return "Pairs that it came across"
    if pairs.computed:
        return "The nearest pairs"
    return "The pairs, confirmed ones first" if pairs.tried else "The pairs, none of them confirmed yet"


def _shown_pair(facts: Facts, pairs: PairsView, pair: PairView, album: Album) -> ShownPair:
    less = pair.minimality.unsafe
    smaller = []
    if less is not None and less.change != pair.change:
        smaller = [f"A smaller change is enough: {less.change}: {less.outcome}."]
    common = common_words(pair)
    picture = album(
        f"pair-{pair.place}.png", f"Pair {pair.place}: both {noun(facts)}s side by side. {pair.words}"
    )
    return ShownPair(
        place=pair.place,
        change=as_sentence(pair.change),
        common=as_sentence(common[0]) if common else "",
        safe=_side_words(facts, pair.safe, pair.confirmation.safe),
        unsafe=_side_words(facts, pair.unsafe, pair.confirmation.unsafe),
        evidence=[*evidence_words(pairs, pair).split(", "), *filter(None, (extent_words(pair), pair.moved))],
        sentences=[*pair_findings(pair), *smaller, *pair_facts(pairs, pair)[1:]],
        picture=picture[0] if picture else None,
    )


def _side_words(facts: Facts, side: SideView, again: ShareView) -> str:
    """Return the outcome of a drive, and how often it was unsafe when it was simulated again."""
    return ". ".join(
        filter(None, (f"{noun(facts)} {side.number}: {side.outcome}", as_sentence(share_words(again))))
    )


def _rest(facts: Facts, pairs: PairsView, full: Sequence[PairView]) -> Table | None:
    """Return the pairs that are not shown in full as a table."""
    if not (facts.searched_pairs or full):
        return None
    shown = {pair.place for pair in full}
    rest = [pair for pair in pairs.pairs if pair.place not in shown]
    if not rest:
        return None
    rows = [
        (
            str(pair.place),
            ": ".join(filter(None, (as_sentence(pair.change), pair.moved))),
            f"{pair.unsafe.outcome} ({pair.unsafe.number})",
            f"{pair.safe.outcome} ({pair.safe.number})",
            evidence_words(pairs, pair),
        )
        for pair in rest[:MOST_ROWS]
    ]
    more = pairs.distinct - len(shown) - len(rows)
    return Table(
        label="Other pairs",
        columns=("", "change", "unsafe side", "safe side", "evidence"),
        rows=rows,
        right=(0,),
        more=f"{more:,} more: brink pairs {facts.view.id} --limit {pairs.distinct}" if more > 0 else "",
    )


def tolerance_section(facts: Facts, album: Album) -> Section | None:
    """Return the requirement on the component; None if the campaign had another purpose."""
    view = facts.tolerance
    if view is None or not view.cells:
        return None
    limits = limiting(view)
    throughout = [cell for cell in view.cells if cell.tolerated.finding is Tolerated.THROUGHOUT]
    lists = [("Tolerated up to a magnitude, tightest first", [cell.sentence for cell in limits[:MOST_ROWS]])]
    if len(limits) > MOST_ROWS:
        lists[0][1].append(f"… and {len(limits) - MOST_ROWS} more in the table.")
    lists.append(("No limit found", [cell.sentence for cell in throughout]))
    lists.append(
        (
            "Where more error is safer",
            [
                f"{as_sentence(cell.error)}, {cell.condition}: {cell.fall.words}."
                for cell in view.cells
                if cell.fall
            ],
        )
    )
    return Section(
        title="The requirement on the component",
        paragraphs=[
            "A cell is a type of error that concerns one target, under one condition. A violation counts if it goes "
            f"away without the error, in the same drive with the same seed. The limit is {view.limit:.0%} of drives.",
            view.caveat,
        ],
        pictures=album(
            "tolerance.png",
            "Share of drives that violate because of an error, against how gross the error is",
        ),
        lists=[(title, sentences) for title, sentences in lists if sentences],
        tables=[_cells_table(view), _baseline_table(view)],
    )


def detector_section(facts: Facts, album: Album) -> Section | None:
    """Return whether the detector of another campaign meets the requirement; None if none was named."""
    view = facts.detector
    if view is None:
        return None
    return Section(
        title=f"Does {view.detector} meet the requirement?",
        paragraphs=[f"{view.note}.", view.meaning, *small_print(view)],
        pictures=album(
            "detector.png", "Shares of drives that errors of this size make violate, against the limit"
        ),
        lists=[("What to record next", [f"{words}." for words in view.next])] if view.next else [],
        tables=[
            Table(
                label="Results of the detector",
                columns=COLUMNS,
                rows=[row_of(cell) for cell in evidence(view)],
                right=[COLUMNS.index(name) for name in NUMBERS],
            )
        ],
    )


def _cells_table(view: ToleranceView) -> Table:
    rows = []
    for cell in view.cells:
        value, interval = tolerated_words(cell)
        rows.append(
            (
                as_sentence(cell.error),
                cell.condition,
                value,
                interval,
                f"{cell.screened:,}",
                f"{cell.vulnerable:,}",
                f"{cell.drives:,}",
                f"{cell.caused:,}",
            )
        )
    return Table(
        label="Tolerated magnitude of each error",
        columns=(
            "error",
            "condition",
            "tolerated",
            f"{view.confidence:.0%} interval",
            "screened",
            "vulnerable",
            "drives",
            "caused",
        ),
        rows=rows,
        right=tuple(range(2, 8)),
        more=f"{as_sentence(KEY)}.",
    )


def _baseline_table(view: ToleranceView) -> Table:
    rows = []
    for one in view.baseline:
        only = " or ".join(" ".join(choices.values()) for choices in one.choices if choices) or "all"
        part = one.share
        rows.append(
            (
                one.condition,
                only.replace("_", " "),
                f"{part.evaluated:,}",
                share(part.unsafe, part.evaluated),
                f"{part.low:.0%} to {part.high:.0%}",
            )
        )
    return Table(
        label="Drives without any error",
        columns=("without any error", "cells", "drives", "violate", "95% interval"),
        rows=rows,
        right=(2, 3, 4),
    )


def violations_section(facts: Facts, album: Album) -> Section | None:
    """Return the types of violations; None if their circumstances are not recorded."""
    found = facts.violations
    if found is None:
        return None
    types = found.types
    if not types:
        return Section(title="Violations", paragraphs=["No drive violated a requirement."])
    fault = {True: "ego", False: "others", None: "differs"}
    rows = [
        (
            kind.avoider,
            kind.avoided_by or "",
            kind.avoided,
            f"{kind.instances:,}",
            fault[kind.at_fault],
            str(kind.example),
            kind.type,
        )
        for kind in types[:MOST_ROWS]
    ]
    pictures = [
        picture
        for place, kind in enumerate(types, start=1)
        if kind.example not in {one.example for one in types[: place - 1]}  # one drive may have several types
        for picture in album(f"violation-{place}.png", f"Drive {kind.example}: {_avoidable_type(kind)}")
    ]
    more = len(types) - len(rows)
    paragraphs = [f"{found.words[:1].upper()}{found.words[1:]}."]
    if any(kind.avoidable for kind in types):
        paragraphs.append(
            "To tell what the system should have avoided, each drive with a violation was driven again by reference "
            "drivers among the same road users, which follow the same scripts. A violation is avoided if the driver "
            f"has neither it nor a collision until 5 s afterwards. {found.explanation}"
        )
    paragraphs.append(
        "Violations with the same circumstances are of one type. Who is at fault by the rule follows from who moved "
        "how; it is no legal judgement."
    )
    return Section(
        title="Types of violations",
        paragraphs=paragraphs,
        gallery=pictures[:MOST_GALLERY],
        tables=[
            Table(
                label="Types of violations, avoidable ones first, then by frequency",
                rows=rows,
                right=(2, 3, 5),
                columns=(
                    "avoidable by",
                    "how",
                    "drives",
                    "distinct",
                    "at fault by the rule",
                    "example",
                    "type of violation",
                ),
                more=f"{more:,} more: brink violations {facts.view.id}" if more else "",
            )
        ],
    )


def _avoidable_type(kind: TypeView) -> str:
    """Return a type and who would have avoided it."""
    return kind.type if kind.avoidable is None else f"{kind.type}; {kind.avoidable.words}"


def combinations_section(facts: Facts, album: Album) -> Section | None:
    """Return the chains of changes to the camera image; None if there are none."""
    found = facts.combinations
    if found is None or not found.combinations:
        return None
    chains = found.combinations
    rows = [
        (
            one.words,
            tally_words(one),
            "; ".join(variant_words(one.parts)) or "not simulated",
            ", ".join(map(tally_words, one.orders)),
            "yes" if one.hazardous else "no",
            added_harm_words(one),
            claim_words(one),
        )
        for one in chains[:MOST_ROWS]
    ]
    more = len(chains) - len(rows)
    return Section(
        title="Changes to the camera image",
        paragraphs=[
            "A chain is a list of changes that are applied to the image in order. It counts as hazardous if it was "
            f"driven in at least {MIN_PLACES} streets, and at least {HAZARDOUS:.0%} of these drives were unsafe. Its "
            f"parts and other orders are compared in the same streets. {CLAIMS} {found.explanation}".rstrip()
        ],
        pictures=[
            picture
            for place, name in enumerate(album.named("combination-"), start=1)
            for picture in album(
                name, f"A chain of changes beside its parts, in the same street with the same seed ({place})"
            )
        ],
        tables=[
            Table(
                label="Chains of changes",
                rows=rows,
                columns=("chain", "unsafe", "its parts", "other order", "hazardous", "added harm", "how"),
                more=f"{more:,} more: brink combinations {facts.view.id} --shown {len(chains)}"
                if more
                else "",
            )
        ],
    )


def boundary_section(facts: Facts, album: Album) -> Section | None:
    """Return the map, with boundary solutions if the search was for them; None if nothing was evaluated."""
    if not facts.evaluated or facts.tolerance is not None:
        return None
    found, searched = facts.boundary, facts.progress.is_for("boundary")
    map_words = "Map of the campaign: each dot is a simulated solution, similar ones lie close together"
    paragraphs, tables = [], []
    if searched and facts.combinations is None:
        near = facts.fetched.plan.neighbourhood
        paragraphs = [
            boundary_words(facts),
            f"The neighbourhood of a solution is all evaluated solutions within a distance of {near.radius:g}, and "
            f"its fitness is how far the interval of their unsafe share lies from {near.p_th:g}: 0 is on the "
            f"boundary. {found.note}",
        ]
        rows = [
            (
                str(one.number),
                one.outcome or str(one.verdict),
                f"{one.fitness:.3f}",
                f"{one.unsafe_neighbours} of {one.neighbours}",
                one.words,
            )
            for one in found.solutions[:MOST_ROWS]
        ]
        more = found.dbs - len(rows)
        if rows:
            tables = [
                Table(
                    label="Distinct boundary solutions, best first",
                    rows=rows,
                    right=(0, 2, 3),
                    columns=("number", "outcome", "fitness", "unsafe neighbours", "description"),
                    more=f"{more:,} more: brink results {facts.view.id}{_listed(found)}" if more else "",
                )
            ]
    pictures = album("map.png", map_words)
    replayed = shown_replays(facts)
    gallery = [
        picture
        for one in found.solutions
        if one.number in replayed
        for words in [f"Boundary solution {one.number}: {one.outcome or one.verdict}"]
        for picture in album(f"replay-{one.number}.png", words)
    ]
    rules = _rules(facts)
    if not (paragraphs or pictures or rules):
        return None
    lists = [("Where unsafe solutions were found", rules)] if rules else []
    title = "The boundary" if searched or facts.searched_pairs else "Where it was unsafe"
    return Section(
        title=title, paragraphs=paragraphs, pictures=pictures, gallery=gallery, lists=lists, tables=tables
    )


def _listed(found: Boundary) -> str:
    """Return what the command lists beyond the table; empty if that is nothing."""
    return f" lists {found.words}" if len(found.solutions) < found.dbs else ""


def _rules(facts: Facts) -> list[str]:
    """Return the rules with the largest unsafe shares, unless they are uninformative."""
    rules = facts.rules
    if rules is None or rules.balanced is None or rules.balanced <= USELESS:
        return []
    overall = rules.held_out_inside / rules.held_out
    titles = facts.fetched.plan.problem.space.titles()
    told = [
        f"{', '.join(_readable(one, titles) for one in rule.conditions)}: {rule.inside} of {rule.solutions} unsafe "
        f"({rule.share:.0%})."
        for rule in rules.rules[:MOST_RULES]
        if rule.conditions and rule.solutions >= LEAST_LEAF and rule.share > overall
    ]
    if not told:
        return []
    return [
        f"On drives that they were not fitted to, these rules tell safe from unsafe with a balanced accuracy of "
        f"{rules.balanced:.0%} (guessing: 50%).",
        *told,
        f"Overall, {overall:.0%} were unsafe. The rules are from a small decision tree fitted to half of the "
        "scenarios; all counts are of the other half.",
    ]


def _readable(condition: str, titles: Mapping[str, str]) -> str:
    """Return a condition on a parameter with its title in place of its name."""
    name, rest = condition.split(" ", 1)
    return f"{titles[name]} {rest}"


def outcomes_section(facts: Facts) -> Section | None:
    """Return which requirements were held and violated; None if nothing was evaluated."""
    view = facts.fetched.outcomes
    if not facts.evaluated:
        return None
    order = list(_KINDS)
    groups = sorted(view.groups, key=lambda group: (-order.index(group.kind), -group.solutions, group.words))
    rows = [
        (group.words, _KINDS[group.kind], f"{group.solutions:,}", share(group.solutions, facts.evaluated))
        for group in groups[:MOST_ROWS]
    ]
    rest = groups[MOST_ROWS:]
    missing = facts.evaluated - view.recorded
    words = []
    if others_recorded(facts):
        words.append(
            "Safe and unsafe are with regard to the requirements of the campaign alone; a safe drive may violate "
            "another one."
        )
    if missing and view.recorded:
        words.append(f"For {count(missing, noun(facts))}, other requirements were not recorded.")
    return Section(
        title="Requirements held and violated",
        paragraphs=words,
        tables=[
            Table(
                label="What the simulations showed",
                columns=("outcome", "verdict", f"{noun(facts)}s", "share"),
                rows=rows,
                right=(2, 3),
                more=f"{len(rest)} rarer outcomes of {sum(one.solutions for one in rest):,} {noun(facts)}s"
                if rest
                else "",
            )
        ],
    )
