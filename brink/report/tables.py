"""Findings of any kind as Markdown."""

from brink.report.text import markdown_text, table_row
from brink.server.findings.finding import Finding
from brink.server.findings.table import Table
from brink.server.findings.words import full_sentence


def finding_markdown(finding: Finding) -> str:
    """Return a finding as Markdown."""
    lines = [f"## {markdown_text(finding.title)}", ""]
    for words in (finding.sentence, *finding.more, *finding.caveats, *finding.legend):
        lines += [markdown_text(full_sentence(words)), ""]
    for table in finding.tables:
        lines += [f"**{markdown_text(table.title)}**", "", *markdown_rows(table), ""]
    return "\n".join(lines)


def markdown_rows(table: Table) -> list[str]:
    """Return the lines of a Markdown table."""
    rules = ["---:" if column.format.is_numeric else "---" for column in table.shown]
    return [
        table_row([column.heading for column in table.shown]),
        table_row(rules),
        *(table_row([text.replace("\n", "; ") for text in row]) for row in table.texts()),
    ]
