"""`brink examples`: the campaign and experiment files that come with Brink, and what they need."""

import re
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final, Self

import typer

import brink
from brink.api.terminal import echo
from brink.cli.options import AsJson, console, plain_table, print_json, program
from brink.server.errors import InvalidInput, nearest

FOLDER: Final = Path(brink.__file__).parent / "examples"
_SENTENCE: Final = re.compile(r".*?[.?!](?=\s|$)|.+", re.DOTALL)
_RUNS: Final = re.compile(r"^(problem|problems|methods|algorithms):", re.MULTILINE)
"""Keys of campaign and experiment files, which definitions of programs lack."""
_SEVERAL: Final = re.compile(r"^problems:", re.MULTILINE)


@dataclass(frozen=True, slots=True, kw_only=True)
class Example:
    """A campaign or experiment file that comes with Brink.

    Attributes:
        name: Its path below the folder of examples, without its ending.
        words: What it is about, in a sentence.
        is_experiment: Whether it is the file of an experiment.
    """

    name: str
    words: str
    is_experiment: bool

    @classmethod
    def of(cls, file: Path) -> Self | None:
        """Return the example in a YAML file; None if the file is that of neither a campaign nor an experiment."""
        text = file.read_text(encoding="utf-8")
        if not _RUNS.search(text):
            return None
        comment = []
        for line in text.splitlines():
            if not line.startswith("#"):
                break
            comment.append(line.removeprefix("#").strip())
        first = _SENTENCE.match(" ".join(comment))
        return cls(
            name=file.relative_to(FOLDER).with_suffix("").as_posix(),
            words=first.group() if first else "",
            is_experiment=_SEVERAL.search(text) is not None,
        )

    @property
    def file(self) -> Path:
        """The file."""
        return FOLDER / f"{self.name}.yaml"

    @property
    def files(self) -> list[Path]:
        """The file and all that it may need: what lies beside it in a folder of its own, or in one of its name."""
        folder = self.file.with_suffix("") if self.file.parent == FOLDER else self.file.parent
        beside = folder.rglob("*") if folder.is_dir() else ()
        needed = sorted(one for one in beside if one.is_file() and "__pycache__" not in one.parts)
        return list(dict.fromkeys([self.file, *needed]))


def all_examples() -> list[Example]:
    """Return all examples, those that need no further file first."""
    files = sorted(FOLDER.rglob("*.yaml"), key=lambda file: (len(file.relative_to(FOLDER).parts), file))
    return [example for file in files if (example := Example.of(file))]


def example_named(name: str, place: str = "NAME") -> Example:
    """Return an example by its name, or by the last part of it.

    Args:
        name: The name, such as ``quickstart``.
        place: Where it was given, for messages.

    Raises:
        InvalidInput: There is no such example, or several end so.
    """
    known = all_examples()
    wanted = name.removesuffix(".yaml")
    found = [one for one in known if one.name == wanted] or [
        one for one in known if one.name.rpartition("/")[2] == wanted
    ]
    if len(found) == 1:
        return found[0]
    if found:
        raise InvalidInput.at(place, f"expected one of {', '.join(one.name for one in found)}; got {name!r}")
    close = nearest(wanted, [one.name for one in known])
    meant = f"did you mean {close!r}? " if close else ""
    raise InvalidInput.at(
        place, f"expected the name of an example, got {name!r:.80}; {meant}{program()} examples lists them"
    )


def examples(
    name: Annotated[
        str | None, typer.Argument(help="An example: print its file, or with --to copy it.")
    ] = None,
    to: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR", show_default=False, help="Folder to copy it to, with the files that it needs."
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """List the examples that come with Brink, or print or copy one.

    Example: brink examples

    Example: brink examples quickstart --to .

    Example: brink run --example quickstart
    """
    if name is None:
        if to is not None:
            raise InvalidInput.at("--to", "requires the name of an example")
        _list(as_json=as_json)
        return
    if as_json:
        raise InvalidInput.at("--json", "cannot be combined with the name of an example")
    example = example_named(name)
    if to is None:
        echo(example.file.read_text(encoding="utf-8"), nl=False)
        return
    targets = {file: to / file.relative_to(FOLDER) for file in example.files}
    if there := [target for target in targets.values() if target.exists()]:
        raise InvalidInput.at("--to", f"{there[0]} exists already; expected a folder without it")
    for file, target in targets.items():
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(file, target)
        echo(target)


def _list(*, as_json: bool) -> None:
    known = all_examples()
    if as_json:
        print_json(
            [
                {
                    "name": one.name,
                    "words": one.words,
                    "kind": "experiment" if one.is_experiment else "campaign",
                }
                for one in known
            ]
        )
        return
    table = plain_table("example", "about")
    for one in known:
        table.add_row(one.name, one.words + (" (experiment)" if one.is_experiment else ""))
    console().print(table)
    console().print(f"copy one: {program()} examples NAME --to DIR", soft_wrap=True)
