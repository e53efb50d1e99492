"""The matrix of a suite: drives by versions."""

from typing import Final

from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from brink.plots.style import INK, MARGIN_PX, MUTED, SMALL_PT, WIDTH_PX, new_figure
from brink.server.suites.matrix import Matrix, mark_of, state_of

MOST_ROWS: Final = 80
MOST_VERSIONS: Final = 12
_COLOURS: Final = {"safe": "#cfe3f2", "unsafe": "#f7cdb5", "other": "#eee6c4", "none": "#ffffff"}
_ROW_PX, _TOP_PX, _BOTTOM_PX, _NAMES_PX = 26, 200, 40, 500
_NAME_CHARACTERS, _VERSION_CHARACTERS = 60, 26


def figure_matrix(matrix: Matrix, suite: str) -> Figure:
    """Plot a matrix: a row for each drive, a column for each version, the newest first.

    Args:
        matrix: The matrix; the first `MOST_ROWS` drives and `MOST_VERSIONS` versions are drawn.
        suite: Name of the suite.
    """
    rows, versions = matrix.rows[:MOST_ROWS], matrix.versions[:MOST_VERSIONS]
    height_px = _TOP_PX + len(rows) * _ROW_PX + _BOTTOM_PX
    turned = " Bold: turned unsafe." if any(row.turned_unsafe for row in rows) else ""
    left_out = f" The first {len(rows)} are shown." if len(rows) < len(matrix.rows) else ""
    figure = new_figure(height_px, suite, f"{matrix.words}. A dark frame: not as expected.{turned}{left_out}")
    left = (MARGIN_PX + _NAMES_PX) / WIDTH_PX
    axes = figure.add_axes((left, _BOTTOM_PX / height_px, 1 - left - 0.03, len(rows) * _ROW_PX / height_px))
    axes.set_xlim(0, max(len(versions), 3))
    axes.set_ylim(len(rows), 0)
    axes.axis("off")
    for place, row in enumerate(rows):
        axes.text(
            -0.05,
            place + 0.5,
            _cut(row.name, _NAME_CHARACTERS),
            ha="right",
            va="center",
            fontsize=SMALL_PT - 1,
            color=INK,
            weight="bold" if row.turned_unsafe else "normal",
        )
        for column, cell in enumerate(row.cells[:MOST_VERSIONS]):
            fails = cell is not None and not cell.passed
            axes.add_patch(
                Rectangle(
                    (column + 0.03, place + 0.07),
                    0.94,
                    0.86,
                    facecolor=_COLOURS[state_of(cell)],
                    edgecolor=INK if fails else "none",
                    linewidth=1.4,
                )
            )
            words = " ".join(filter(None, (mark_of(cell), "" if cell is None else cell.simulated)))
            axes.text(
                column + 0.5, place + 0.5, words, ha="center", va="center", fontsize=SMALL_PT - 1.5, color=INK
            )
    for column, version in enumerate(versions):
        axes.text(
            column + 0.1,
            -0.25,
            _cut(version, _VERSION_CHARACTERS),
            ha="left",
            va="bottom",
            rotation=20,
            fontsize=SMALL_PT - 1,
            color=MUTED,
        )
    return figure


def _cut(text: str, most: int) -> str:
    return text if len(text) <= most else f"{text[: most - 1]}…"
