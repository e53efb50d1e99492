"""Runs of suites for others to read: JUnit XML, Markdown for a pull request, and the matrix of several versions."""

from collections.abc import Mapping
from typing import Final
from xml.etree import ElementTree as Xml

from brink.report.page import page_template
from brink.report.text import markdown_text, table_row
from brink.search.analysis.suite import SuiteVerdict
from brink.server.suites.matrix import Matrix, mark_of, state_of
from brink.server.suites.results import CaseResult, SuiteResults, sorted_cases
from brink.worker.printable import printable

MOST_CASES: Final = 50
"""Most drives in a table of a pull request."""


def junit_xml(results: SuiteResults) -> str:
    """Return a run as JUnit XML: a test suite for each system, a test case for each drive.

    A drive that is not as expected is a failure; one that cannot run, or was not simulated to its end, an error. A
    known hazard that is still there is skipped, as a test that is expected to fail is.
    """
    root = Xml.Element("testsuites", name=_plain(results.suite))
    totals = {"tests": 0, "failures": 0, "errors": 0, "skipped": 0}
    for system in dict.fromkeys(case.system for case in results.cases):
        suite = Xml.SubElement(
            root,
            "testsuite",
            name=_plain(f"{results.suite}: {system}"),
            timestamp=results.at.removesuffix("Z"),
        )
        counts = dict.fromkeys(totals, 0)
        for case in results.cases:
            if case.system == system:
                counts["tests"] += 1
                kind = _add_case(suite, case, results.suite)
                if kind:
                    counts[kind] += 1
        for name, count in counts.items():
            suite.set(name, str(count))
            totals[name] += count
    for name, count in totals.items():
        root.set(name, str(count))
    Xml.indent(root)
    return Xml.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def _add_case(suite: Xml.Element, case: CaseResult, name: str) -> str:
    """Add a test case, and return the count to which it belongs; empty if it passed."""
    element = Xml.SubElement(
        suite, "testcase", classname=_plain(f"{name}.{case.system}"), name=_plain(case.name), time="0"
    )
    words = _plain(case.shown)
    kind = ""
    if case.verdict in (SuiteVerdict.CANNOT_RUN, SuiteVerdict.OPEN):
        Xml.SubElement(element, "error", message=words, type=case.verdict.value)
        kind = "errors"
    elif not case.passed:
        Xml.SubElement(element, "failure", message=words, type=case.verdict.value).text = _plain(case.words)
        kind = "failures"
    elif case.verdict in (SuiteVerdict.STILL_UNSAFE, SuiteVerdict.UNCLEAR):
        Xml.SubElement(element, "skipped", message=words)
        kind = "skipped"
    Xml.SubElement(element, "system-out").text = words
    return kind


def _plain(text: str) -> str:
    """Return a text without characters that XML cannot have."""
    return printable(text)


def markdown(results: SuiteResults, pictures: Mapping[str, str]) -> str:
    """Return a run as a comment on a pull request.

    Args:
        results: The run.
        pictures: Address of the picture of a drive, by the name of the drive.
    """
    cases = sorted_cases(results.cases)
    failing = [case for case in cases if not case.passed]
    state = "all as expected" if not failing else f"**{len(failing)} not as expected**"
    against = f", compared with {results.against}" if results.against else ""
    lines = [f"### {markdown_text(results.suite)}: {state}", ""]
    lines += [markdown_text(f"{results.words} ({results.label}{against})."), ""]
    fixed = results.of(SuiteVerdict.FIXED)
    shown = [*failing, *fixed][:MOST_CASES]
    if shown:
        lines += [table_row(["drive", "verdict", "unsafe", "expected", "why"]), table_row(["---"] * 5)]
        lines += [
            table_row([one.name, one.verdict.value, one.simulated or "–", one.expect, one.reason])
            for one in shown
        ]
        if more := len(failing) + len(fixed) - len(shown):
            lines.append(f"\n… and {more} more")
        lines.append("")
    if fixed:
        lines += [
            "Fixed: set `expect: safe` for these, so that a hazard that comes back fails the build.",
            "",
        ]
    for case in failing:
        if case.name in pictures:
            lines += [f"**{markdown_text(case.name)}**: {markdown_text(case.words)}", ""]
            lines += [f"![{markdown_text(case.name)}]({pictures[case.name]})", ""]
    return "\n".join(lines)


def matrix_page(matrix: Matrix, suite: str) -> str:
    """Return the matrix as an HTML page.

    Args:
        matrix: The matrix.
        suite: Name of the suite.
    """
    return page_template("suite.html").render(suite=suite, matrix=matrix, mark_of=mark_of, state_of=state_of)
