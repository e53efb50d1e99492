"""Pairs as text: a table of the first ones, and the meaning of its terms."""

from rich.console import Console
from rich.table import Table
from rich.text import Text

from brink.cli.options import plain_table, print_sentence
from brink.server.findings.pairs.views import MOST_PAIRS, PairsView
from brink.server.findings.pairs.words import extent_words
from brink.server.problems.changes import as_sentence


def print_pairs(screen: Console, view: PairsView) -> None:
    """Print a summary and the first pairs."""
    print_sentence(screen, Text.assemble((view.name, "bold"), f" ({view.campaign}): {view.note}"))
    if not view.pairs:
        return
    print_sentence(
        screen,
        f"a safe and an unsafe drive at most {view.eps:g} apart on average over all parameters, or one step; pairs "
        f"at least {view.d_th:g} apart",
        style="dim",
    )
    for words in filter(None, (view.blame, *view.chance)):
        print_sentence(screen, words)
    screen.print(pairs_table(view))
    print_legend(screen, view)
    if view.distinct > len(view.pairs):
        screen.print(
            f"and {view.distinct - len(view.pairs)} more: --limit {min(view.distinct, MOST_PAIRS)}",
            style="dim",
        )


def print_legend(screen: Console, view: PairsView) -> None:
    """Print the meaning of the table's terms, and the limits of what pairs show."""
    for words in view.legend:
        print_sentence(screen, words, style="dim")
    if view.caveat:
        print_sentence(screen, view.caveat)


def pairs_table(view: PairsView, shown: int | None = None) -> Table:
    """Return a table of the first pairs: the change in words, the outcomes of both drives, and the evidence."""
    table = plain_table(
        "pair", "change from the safe to the unsafe drive, and what both showed", "evidence", right=("pair",)
    )
    for pair in view.pairs[:shown]:
        lines = [
            as_sentence(pair.change),
            *([f"({pair.moved})"] if pair.moved else []),
            *([f"in both: {pair.common}"] if pair.common else []),
            f"unsafe, solution {pair.unsafe.number}: {pair.unsafe.outcome}",
            f"safe, solution {pair.safe.number}: {pair.safe.outcome}",
        ]
        less = pair.minimality.unsafe
        if less is not None and less.change != pair.change:
            name = "minimal" if less.minimal else "smaller"
            lines.append(f"{name} change: {less.change}: {less.outcome}")
        evidence = [*pair.evidence, extent_words(pair)]
        table.add_row(str(pair.place), "\n".join([*lines, ""]), "\n".join(evidence))
    return table
