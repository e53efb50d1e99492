"""An unknown command is answered with the one that may have been meant, or with those that there are."""

import pytest
from typer.testing import CliRunner

from brink.cli.commands import app
from brink.server.errors import FieldError, field_name


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["statsu"], "no command 'statsu'; did you mean 'status'? see "),
        (["foo"], "no command 'foo'; see "),
        (["monitor", "e602ddf1"], "no command 'e602ddf1'; expected one of fit, score, judge; see "),
    ],
)
def test_an_unknown_command_names_those_there_are(words: list[str], said: str) -> None:
    ended = CliRunner().invoke(app, words)
    assert ended.exit_code == 2
    assert said in ended.output


@pytest.mark.parametrize(
    ("pointer", "name"),
    [
        ("/problem/params/requirement", "problem.params.requirement"),
        ("/solutions/0/values/a~1b", "solutions[0].values.a/b"),
        ("/query/eps", "eps"),
        ("/path/campaign_id", ""),
        ("/", ""),
        ("", ""),
        ("--out", "--out"),
    ],
)
def test_messages_name_fields_as_the_campaign_file_does(pointer: str, name: str) -> None:
    assert field_name(pointer) == name
    assert str(FieldError(pointer=pointer, message="expected 1")) == (
        f"{name}: expected 1" if name else "expected 1"
    )
