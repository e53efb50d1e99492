"""Tables that several commands print."""

from typing import Any

from rich.table import Table

SHOWN = 5


def grid_table(grid: list[dict[str, Any]]) -> Table:
    """Return DBS and strict DBS over the paper's grid of thresholds."""
    t_bs = sorted({cell["t_b"] for cell in grid})
    table = Table(title="DBS (strict DBS)", title_justify="left", title_style="dim", box=None, pad_edge=False)
    table.add_column("d_th", style="dim")
    for t_b in t_bs:
        table.add_column(f"t_b {t_b:g}", justify="right", header_style="dim")
    for d_th in sorted({cell["d_th"] for cell in grid}):
        cells = {cell["t_b"]: cell for cell in grid if cell["d_th"] == d_th}
        table.add_row(f"{d_th:g}", *(f"{cells[t]['dbs']} ({cells[t]['strict_dbs']})" for t in t_bs))
    return table


def solution_table(boundary: dict[str, Any], shown: int = SHOWN) -> Table:
    """Return the best boundary solutions as a table."""
    table = Table(box=None, pad_edge=False, header_style="dim")
    for name in ("number", "verdict", "robustness", "fitness", "unsafe near it", "what it is"):
        table.add_column(name, justify="left" if name in ("verdict", "what it is") else "right")
    for solution in boundary["solutions"][:shown]:
        table.add_row(
            str(solution["number"]),
            solution["verdict"],
            f"{solution['robustness']:.2f}",
            f"{solution['fitness']:.3f}",
            f"{solution['unsafe_neighbours']} of {solution['neighbours']}",
            solution["words"],
        )
    if len(boundary["solutions"]) > shown:
        table.add_row("…", "", "", "", "", f"and {len(boundary['solutions']) - shown} more in boundary.csv")
    return table
