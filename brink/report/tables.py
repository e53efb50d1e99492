"""Findings of any kind as Markdown, and as sections of the HTML report."""

from brink.report.campaign_sections import Section
from brink.report.campaign_sections import Table as PageTable
from brink.report.text import markdown_text, table_row
from brink.server.findings.finding import Finding
from brink.server.findings.table import Table
from brink.server.findings.words import full_sentence


def finding_section(finding: Finding, campaign: str) -> Section:
    """Return a finding as a section of the report.

    Args:
        finding: The finding.
        campaign: Id of the campaign.
    """
    return Section(
        title=finding.title,
        paragraphs=[full_sentence(words) for words in (finding.sentence, *finding.more)],
        tables=[
            page_table(table, f"brink findings {campaign} {finding.kind}")
            for table in finding.tables
            if table.rows
        ],
    )


def page_table(table: Table, command: str) -> PageTable:
    """Return a table for a page of HTML.

    Args:
        table: The table.
        command: The command that shows all of its rows.
    """
    return PageTable(
        label=table.title,
        columns=[column.heading for column in table.shown],
        rows=table.texts(),
        right=[place for place, column in enumerate(table.shown) if column.format.is_numeric],
        more=f"{table.left_out:,} more: {command}" if table.left_out else "",
    )


def finding_markdown(finding: Finding) -> str:
    """Return a finding as Markdown."""
    lines = [f"## {markdown_text(finding.title)}", ""]
    for words in (finding.sentence, *finding.more):
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
        *map(table_row, table.texts()),
    ]
