"""Sections of a campaign's report: any finding as a section, and the pictures of the page."""

import base64
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from PIL import Image

from brink.search.analysis.rules import LEAST_LEAF, USELESS, Rules
from brink.server.findings.finding import Finding
from brink.server.findings.table import Table
from brink.server.findings.words import full_sentence

MOST_RULES: Final = 4
LARGE_BYTES: Final = 1_000_000
JPEG_QUALITY: Final = 88


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture on the page."""

    source: str
    words: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Article:
    """An example that the page shows in full: two sides and a picture of both."""

    title: str
    common: str
    safe: str
    unsafe: str
    chips: Sequence[str]
    sentences: Sequence[str]
    picture: Picture | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Section:
    """A section of the page; its parts are shown in the order of the attributes.

    Attributes:
        title: Heading.
        paragraphs: What it says.
        articles: Examples that are shown in full.
        pictures: Pictures as wide as the page.
        gallery: Smaller pictures side by side, with their words below.
        tables: Tables; one with a single column is shown as a list.
        command: The command that shows all rows of the tables.
        lists: Headings with sentences.
    """

    title: str
    paragraphs: Sequence[str] = ()
    articles: Sequence[Article] = ()
    pictures: Sequence[Picture] = ()
    gallery: Sequence[Picture] = ()
    tables: Sequence[Table] = ()
    command: str = ""
    lists: Sequence[tuple[str, Sequence[str]]] = ()


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


def finding_section(finding: Finding, campaign: str) -> Section:
    """Return a finding as a section of the report.

    Args:
        finding: The finding.
        campaign: Id of the campaign.
    """
    legend = [full_sentence(words) for words in finding.legend]
    return Section(
        title=finding.title,
        paragraphs=[full_sentence(words) for words in (finding.sentence, *finding.more)],
        lists=[("How to read it", legend)] if legend else [],
        tables=[table for table in finding.tables if table.rows],
        command=f"brink findings {campaign} {finding.kind}",
    )


def map_section(rules: Rules | None, titles: Mapping[str, str], album: Album) -> Section | None:
    """Return the map of the solutions, and rules that tell where unsafe ones were found; None without either.

    Args:
        rules: The rules of the unsafe region.
        titles: What people read in place of each parameter's name.
        album: The pictures of the report.
    """
    words = "Map of the campaign: each dot is a simulated solution, similar ones lie close together"
    pictures, told = album("map.png", words), _rules(rules, titles)
    if not (pictures or told):
        return None
    lists = [("Where unsafe solutions were found", told)] if told else []
    return Section(title="Where it was unsafe", pictures=pictures, lists=lists)


def _rules(rules: Rules | None, titles: Mapping[str, str]) -> list[str]:
    """Return the rules with the largest unsafe shares, unless they are useless."""
    if rules is None or rules.balanced is None or rules.balanced <= USELESS:
        return []
    overall = rules.held_out_inside / rules.held_out
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
