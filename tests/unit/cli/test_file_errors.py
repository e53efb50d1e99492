"""Errors in campaign and experiment files name the file, the line and the field."""

from pathlib import Path

import pytest

from brink.api.client import CoordinatorError
from brink.cli.options import about_file
from brink.server.errors import FieldError, InvalidInput

TEXT = """\
name: night-rain
algorithms:
  - id: random@1
  - id: mlcshe@1
    params:
      "a/b": 0.1
budget:
  simulations: 100
"""


@pytest.fixture
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    Path("x.yaml").write_text(TEXT)
    return Path("x.yaml")


@pytest.mark.parametrize(
    ("pointer", "place"),
    [
        ("/name", "x.yaml: line 1: name"),
        ("/algorithms/1/id", "x.yaml: line 4: algorithms[1].id"),
        ("/algorithms/1/params/a~1b", "x.yaml: line 6: algorithms[1].params.a/b"),
        ("/budget/simulation", "x.yaml: line 7: budget.simulation"),
        ("/seed", "x.yaml: seed"),
        ("", "x.yaml"),
        ("/", "x.yaml"),
        ("--port", "--port"),
    ],
)
def test_an_error_names_the_file_the_line_and_the_field(file: Path, pointer: str, place: str) -> None:
    with pytest.raises(InvalidInput) as caught, about_file(file):
        raise InvalidInput.at(pointer, "expected more")
    assert str(caught.value) == f"{place}: expected more"
    assert caught.value.errors[0].pointer == pointer, "programs go by the pointer"


def test_fields_that_a_coordinator_rejects_are_found_in_the_file(file: Path) -> None:
    wrong = FieldError(pointer="/algorithms/0/id", message="unknown algorithm", nearest="random@2")
    with (
        pytest.raises(
            InvalidInput, match=r"^x.yaml: line 3: algorithms\[0\].id: unknown algorithm \(did you"
        ),
        about_file(file),
    ):
        raise CoordinatorError("rejected", [wrong])
    with pytest.raises(CoordinatorError, match="no coordinator answers"), about_file(file):
        raise CoordinatorError("no coordinator answers")


@pytest.mark.parametrize("content", ["a: [", "\t", "a: 1\na: 2"])
def test_without_a_readable_file_its_name_is_told_at_least(file: Path, content: str) -> None:
    file.write_text(content)
    with pytest.raises(InvalidInput, match=r"^x.yaml: (line \d+: )?name: expected"), about_file(file):
        raise InvalidInput.at("/name", "expected more")


def test_a_place_that_is_known_already_stays(file: Path) -> None:
    told = pytest.raises(InvalidInput, match=r"^x.yaml: line 1: name: expected more$")
    with told, about_file(Path("y.yaml")), about_file(file):
        raise InvalidInput.at("/name", "expected more")
