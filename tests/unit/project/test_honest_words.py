"""Words that promise more than the product measures appear nowhere that people read."""

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]
READ = ("README.md", "docs", "examples", "brink", "server", "search", "sim", "worker")
KINDS = {".md", ".py", ".js", ".html", ".yaml", ".ipynb"}


def files() -> list[Path]:
    below = [
        path
        for name in READ
        for path in ([ROOT / name] if name.endswith(".md") else (ROOT / name).rglob("*"))
    ]
    return [path for path in below if path.suffix in KINDS]


def test_pairs_are_not_called_almost_the_same() -> None:
    """The sides of a pair are close on average: one number may move by half of its range."""
    claim = re.compile(r"almost\s+(?:the\s+same|equal\s+solutions|identical)")
    assert [path for path in files() if claim.search(path.read_text(encoding="utf-8"))] == []
