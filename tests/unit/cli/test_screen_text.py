"""What the commands print is shown as it is: square brackets are part of names and messages, not markup."""

import io
import re
import tomllib
from pathlib import Path

import pytest
from rich.console import Console
from rich.text import Text

from brink.cli import worker
from brink.cli.main import main
from brink.cli.options import console, plain_table, print_line, print_sentence
from brink.extras import install_command

ROOT = Path(__file__).parents[3]
CLI = sorted((ROOT / "brink" / "cli").rglob("*.py"))
EXTRAS = sorted(
    tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]
)
MARKUP = re.compile(
    r"\[/?(?:dim|bold|italic|red|green|yellow|blue|cyan|magenta)[^\]]*\]|rich\.markup|\.status\(|from_markup"
)
"""What makes markup of text, or of the text of a status line."""


@pytest.mark.parametrize("extra", EXTRAS)
def test_the_name_of_an_extra_is_printed(extra: str, capsys: pytest.CaptureFixture[str]) -> None:
    command = install_command(extra)
    assert command.endswith(f"[{extra}]'")
    table = plain_table("what", command)
    table.add_row("missing", command)
    console().print(f"left out: {command}", style="yellow", soft_wrap=True)
    console().print(Text.assemble((command, "bold")))
    console().print(table)
    print_line(command)
    console(stderr=True).print(command, soft_wrap=True)
    shown = capsys.readouterr()
    assert shown.out.count(command) == 5
    assert shown.err.count(command) == 1


def test_usage_errors_print_the_name_of_an_extra(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(worker, "find_spec", lambda name: None)
    monkeypatch.setattr("sys.argv", ["brink", "worker", "--ray", "local"])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
    assert "'.[ray]'" in capsys.readouterr().err


@pytest.mark.parametrize("file", CLI, ids=lambda file: file.name)
def test_commands_print_without_markup(file: Path) -> None:
    """A console with markup would swallow what looks like a tag, so there is none, and nothing written for one."""
    text = file.read_text(encoding="utf-8")
    assert not MARKUP.findall(text), "give print a style=, or a Text: console() takes no markup"
    if file.name != "options.py":
        assert not re.findall(r"\bConsole\(", text), "use console() of brink.cli.options"


@pytest.mark.parametrize("terminal", [True, False])
def test_a_sentence_is_broken_between_words_on_a_terminal_alone(terminal: bool) -> None:
    file = io.StringIO()
    screen = Console(file=file, width=30, force_terminal=terminal, color_system=None)
    print_sentence(screen, "one two three four five six seven eight nine ten")
    lines = [line.rstrip() for line in file.getvalue().splitlines()]
    assert lines == (
        ["one two three four five six", "seven eight nine ten"]
        if terminal
        else ["one two three four five six seven eight nine ten"]
    )
