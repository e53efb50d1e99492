"""Hazardous chains of techniques, in words and as pictures of each chain with its parts."""

import asyncio
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import UnionType
from typing import TYPE_CHECKING, Any, Final

from brink.report.figures import Drawing
from brink.server.findings.combinations.views import ChainTally, Combinations, CombinationView, Variant

if TYPE_CHECKING:
    from brink.pictures.sheets import Row


def claim_words(one: CombinationView) -> str:
    """Return in which ways a chain is hazardous; "minimal" is omitted where "only together" implies it."""
    claims = {
        "only together": one.only_together,
        "another order is safe": one.order_matters,
        "minimal": one.minimal and not one.only_together,
    }
    return ", ".join(name for name, holds in claims.items() if holds)


def added_harm_words(one: CombinationView) -> str:
    """Return the added harm of a chain, such as ``+0.120 (interacts)``; empty if it is unknown."""
    if one.added_harm is None:
        return ""
    rounded = round(one.added_harm, 3)
    words = f"{rounded:+.3f}" if rounded else "0.000"  # without the sign of -0.0
    return f"{words} (interacts)" if one.interacts else words


COLUMNS: Final[Mapping[str, type | UnionType]] = {
    "chain": str,
    "unsafe": int,
    "trials": int,
    "alpha": float,
    "added_harm": float,
    "interacts": bool | None,
    "hazardous": bool,
    "only_together": bool,
    "order_matters": bool,
    "minimal": bool,
    "example": int | None,
}
"""Columns of a table of chains; `example` is an unsafe solution whose parts or other order are safe."""


def combination_rows(found: Combinations) -> list[dict[str, Any]]:
    """Return the chains as rows with the columns `COLUMNS`; unknown values are None."""
    names = [name for name in COLUMNS if name not in ("chain", "example")]
    return [
        {
            "chain": one.words,
            **{name: getattr(one, name) for name in names},
            "example": next(iter((*one.together, *one.turned)), None),
        }
        for one in found.combinations
    ]


CLAIMS: Final = (
    "Only together: each part of the chain alone is safe, which is to say unsafe in at most 20% of these drives. "
    "Another order is safe: so is the same chain in another order. Minimal: no part alone is hazardous, but not all "
    "are safe."
)
"""What the claims about a chain mean."""


def tally_words(tally: ChainTally) -> str:
    """Return how often a chain was unsafe, such as ``2 of 3``."""
    return f"{tally.unsafe} of {tally.trials}"


def variant_words(variants: Sequence[ChainTally]) -> list[str]:
    """Return how often each of several chains was unsafe, such as ``["unperturbed: 0 of 3", "snow 1/5: 2 of 3"]``."""
    return [f"{one.words}: {tally_words(one)}" for one in variants]


async def draw_chains(found: Combinations, drawing: Drawing, most: int) -> list[Path]:
    """Draw the clearest combinations, each with its parts and other orders; return the files.

    Args:
        found: The combinations, most informative first.
        drawing: The campaign and the folder.
        most: Number of combinations to draw.
    """
    from brink.pictures.sheets import side_by_side  # slow to import

    files: list[Path] = []
    for one in found.combinations:
        if drawing.stop.is_set() or len(files) == most:
            break
        solutions = one.together or one.turned
        drawing.show("drawing combinations", len(files), most)
        rows = await _variants(drawing, solutions[0]) if solutions else []
        if not rows or any(row.trace.film is None for row in rows):
            continue
        title = f"The same street with the same seed: solution {solutions[0]} and its parts"
        picture = await asyncio.to_thread(side_by_side, rows, title=title)
        path = drawing.folder / f"combination-{len(files) + 1}.png"
        await asyncio.to_thread(picture.save, path)
        files.append(path)
    return files


async def _variants(drawing: Drawing, number: int) -> "list[Row]":
    """Return the traces of a solution and its variants; empty if one of them is not available."""
    from brink.pictures.sheets import Row

    path = f"/campaigns/{drawing.campaign}/solutions/{number}/variants"
    rows = []
    for variant in await drawing.api.read(list[Variant], path):
        trace = await drawing.trace(variant.number)
        if trace is None:
            return []
        rows.append(Row(words=variant.words, trace=trace))
    return rows
