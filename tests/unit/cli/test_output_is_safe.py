"""Text of others is harmless wherever it is written: in CSV for spreadsheets, on terminals, and in logs."""

import ast
import csv
import io
import json
import logging
import sys
from pathlib import Path

import pytest
from rich.table import Table
from rich.text import Text

import brink
from brink.api.terminal import PlainConsole, echo
from brink.cli.main import _describe
from brink.cli.options import console
from brink.server.csv_text import csv_text
from brink.server.errors import InvalidInput
from brink.server.findings.table import table_bytes
from brink.worker.log import JsonFormatter, LineFormatter

PACKAGE = Path(brink.__file__).parent
FOLDERS = [
    "api",
    "cli",
    "guard",
    "pictures",
    "plots",
    "python",
    "report",
    "scenarios",
    "search",
    "server",
    "sim",
    "worker",
]
HOSTILE = "\x1b]0;owned\x07\x1b[2J\x9b31m\u202e\x7f\r"
SHOWN = r"\u001b]0;owned\u0007\u001b[2J\u009b31m\u202e\u007f\u000d"

FORMULAS = [
    '=HYPERLINK("http://x")',
    "+1+cmd|' /C calc'!A0",
    "-2+3",
    "@SUM(A1)",
    "\t=1",
    "\n=1",
    "＝1",
    "-",
    "+x",
]
NUMBERS = ["-1.5", "+2", "-1e-05", "-.5", "-3%", "-inf", "12", ""]


@pytest.mark.parametrize("text", FORMULAS)
def test_csv_marks_what_a_spreadsheet_would_run(text: str) -> None:
    ((header,), (cell,)) = csv.reader(io.StringIO(csv_text([[text], [text]]), newline=""))
    assert header == cell == f"'{text}"
    written = list(csv.DictReader(io.StringIO(table_bytes([{text: text}], "csv", {}).decode(), newline="")))
    assert written == [{f"'{text}": f"'{text}"}]


def test_a_return_begins_no_row() -> None:
    assert csv_text([["a\r=1", "\r=1", "\r\n"]]) == '"a\n=1","\'\n=1","\'\n"\n'


@pytest.mark.parametrize("text", NUMBERS)
def test_csv_leaves_numbers_as_they_are(text: str) -> None:
    assert csv_text([[text, "x"]]) == f"{text},x\n"


def test_csv_writes_values_as_before() -> None:
    assert csv_text([[-1.5, -3, None, True, "a,b", "it's"]]) == '-1.5,-3,,True,"a,b",it\'s\n'


WRITERS = {
    **dict.fromkeys(("csv.writer", "csv.DictWriter"), "csv"),
    **dict.fromkeys(
        ("print", "Console", "stream.write", "typer.echo", "typer.secho", "click.echo"), "terminal"
    ),
    **dict.fromkeys(("rich.print", "sys.stdout.write", "sys.stderr.write"), "terminal"),
}
"""What a call writes to, by the name of the function."""
ATTRIBUTES = {"to_csv", *(name.rpartition(".")[2] for name in WRITERS)}


def _written(node: ast.Call) -> str:
    """Return what a call writes to: ``csv``, ``terminal``, or nothing."""
    if isinstance(node.func, ast.Name):
        return WRITERS.get(node.func.id, "")
    if not isinstance(node.func, ast.Attribute) or node.func.attr not in ATTRIBUTES:
        return ""
    return "csv" if node.func.attr == "to_csv" else WRITERS.get(ast.unparse(node.func), "")


def test_nobody_writes_csv_or_to_the_terminal_by_another_way() -> None:
    found = {
        (f"{folder}/{path.relative_to(PACKAGE / folder)}", kind)
        for folder in FOLDERS
        for path in (PACKAGE / folder).rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Call) and (kind := _written(node))
    }
    assert found == {
        ("server/csv_text.py", "csv"),
        ("api/terminal.py", "terminal"),
        ("cli/main.py", "terminal"),  # before anything is imported
        ("worker/run.py", "terminal"),  # a wrong setting, before the log is set up
        ("scenarios/replay_in_carla.py", "terminal"),  # copied beside an exported drive, to run without Brink
        ("sim/perception/detector.py", "terminal"),  # read by the process that started it
    }


@pytest.mark.parametrize("wrapped", [str, Text, lambda text: Text(text, style="red")])
def test_the_console_shows_control_characters(wrapped: type[str]) -> None:
    out = io.StringIO()
    screen = PlainConsole(file=out, force_terminal=True, width=200)
    table = Table()
    table.add_column("name")
    table.add_row(wrapped(HOSTILE))
    screen.print(wrapped(HOSTILE), soft_wrap=True)
    screen.print(table)
    assert "\x1b]" not in out.getvalue()
    assert not set("\x07\x9b\u202e\x7f\r") & set(out.getvalue())
    assert r"\u001b[2J" in out.getvalue()
    assert "[red]" not in out.getvalue()


def test_all_consoles_are_plain() -> None:
    assert isinstance(console(), PlainConsole)
    assert isinstance(console(stderr=True), PlainConsole)


def test_echo_is_printable_on_a_terminal_and_exact_in_a_pipe(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    echo(HOSTILE)
    assert capsys.readouterr().out == f"{HOSTILE}\n"
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    echo(HOSTILE)
    assert capsys.readouterr().out == f"{SHOWN}\n"


def test_errors_of_the_command_line_are_printable(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    from brink.cli import commands, main

    def fail() -> None:
        raise InvalidInput.at("", HOSTILE)

    monkeypatch.setattr(commands, "app", fail)
    with pytest.raises(SystemExit):
        main.main()
    assert capsys.readouterr().err == f"brink: {SHOWN}\n"
    assert _describe(InvalidInput.at("", "x")) == ["x"]


@pytest.mark.parametrize("formatter", [LineFormatter(), JsonFormatter()])
def test_logs_show_control_characters(formatter: logging.Formatter) -> None:
    record = logging.makeLogRecord({"msg": f"job failed: {HOSTILE}", "levelname": "WARNING", "name": "brink"})
    record.reason = HOSTILE
    record.exc_info = (ValueError, ValueError(HOSTILE), None)
    line = formatter.format(record)
    assert not set("\x1b\x07\x9b\u202e\x7f\r") & set(line)
    if isinstance(formatter, JsonFormatter):
        assert json.loads(line)["reason"] == HOSTILE
    else:
        assert rf"job failed: {SHOWN}" in line
