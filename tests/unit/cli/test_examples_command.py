"""`brink examples` lists, prints and copies the examples that come with Brink; `brink run --example` runs them."""

import json
from pathlib import Path

import pytest
import yaml
from typer.testing import CliRunner

from brink.cli.commands import app
from brink.cli.examples import FOLDER, all_examples


def shown(*arguments: str) -> str:
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    return result.output


def refused(*arguments: str) -> str:
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code != 0
    return " ".join(f"{result.output} {result.exception}".replace("│", " ").split())


def test_every_campaign_and_experiment_file_is_listed_with_a_sentence() -> None:
    listed = {one["name"]: one for one in json.loads(shown("examples", "--json"))}
    files = {file: yaml.safe_load(file.read_text(encoding="utf-8")) for file in FOLDER.rglob("*.yaml")}
    runnable = {
        file.relative_to(FOLDER).with_suffix("").as_posix(): "problems" in content
        for file, content in files.items()
        if isinstance(content, dict) and content.keys() & {"problem", "problems"}
    }
    assert {name: one["kind"] == "experiment" for name, one in listed.items()} == runnable
    assert not [name for name, one in listed.items() if len(one["words"].split()) < 3]


def test_an_example_is_printed() -> None:
    assert shown("examples", "quickstart") == (FOLDER / "quickstart.yaml").read_text(encoding="utf-8")


def test_an_example_is_copied_with_the_files_that_it_needs(tmp_path: Path) -> None:
    shown("examples", "wide_gap", "--to", str(tmp_path))
    assert (tmp_path / "plugins" / "wide_gap.py").read_bytes() == (
        FOLDER / "plugins" / "wide_gap.py"
    ).read_bytes()
    assert "exists already" in refused("examples", "wide_gap", "--to", str(tmp_path))


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["examples", "quickstar"], "did you mean 'quickstart'?"),
        (["examples", "--to", "somewhere"], "requires the name of an example"),
        (["examples", "mtq", "--json"], "cannot be combined with the name"),
        (["run", "--example", "nothing-like-it"], "expected the name of an example"),
        (["run", "--example", "mtq", "mtq.yaml"], "cannot be combined with a file"),
        (["run", "--example", "edge-experiment"], "is an experiment"),
        (["run"], "expected a campaign file, or --example NAME"),
    ],
)
def test_wrong_usage_says_what_was_expected(arguments: list[str], said: str) -> None:
    assert said in refused(*arguments)


def test_examples_have_names_of_their_own() -> None:
    names = [example.name for example in all_examples()]
    assert len(names) == len(set(names)) > 20
