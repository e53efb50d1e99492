"""Suite files: they are read as written, hand edits are checked with their lines, changes leave the rest alone."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from brink.server.errors import InvalidInput
from brink.server.suites.file import (
    Drive,
    Entry,
    NewEntry,
    System,
    _entry_text,
    _system_text,
    add_entries,
    parse_suite,
    read_suite,
    remove_entries,
    rename_entry,
    write_suite,
)

VALUES = {"scenario.gap": 12.5, "scenario.weather": "rain", "behaviour.onset": 1e-05}
UNITS = {"scenario.gap": "m", "behaviour.onset": "s"}
SYSTEM = System(problem="toy@1", params={"requirement": "gap@1", "limits": [1, 2]}, simulator="toy@1")


def drive(side: str, **changes: Any) -> Drive:
    fields = {
        "expect": side,
        "unsafe": 4 * (side == "unsafe"),
        "of": 4,
        "found": "2026-11-28",
        "values": VALUES,
    }
    return Drive.model_validate({**fields, **changes})


def entry(name: str, *sides: str, **changes: Any) -> NewEntry:
    drives: dict[str, Any] = {side: drive(side) for side in sides or ("unsafe",)}
    fields = {"name": name, "system": "toy", "seed": 7, "campaign": "3f2a1b2c", **drives, **changes}
    return NewEntry(entry=Entry.model_validate(fields), units=UNITS)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "hazards.yaml"
    write_suite(path, {"toy": SYSTEM}, [entry("one"), entry("two", "unsafe", "safe"), entry("three", "safe")])
    return path


def test_a_suite_is_read_as_it_was_written(file: Path) -> None:
    read = read_suite(file)
    assert read.systems == {"toy": SYSTEM}
    assert [one.kind for one in read.entries] == ["unsafe", "pair", "safe"]
    assert read.entries[1] == entry("two", "unsafe", "safe").entry
    assert "    scenario.gap: 12.5  # m\n" in file.read_text()
    before = file.read_text()
    write_suite(file, read.systems, [NewEntry(entry=one, units=UNITS) for one in read.entries])
    assert file.read_text() == before, "stable, so that a diff shows what changed"


scalars = st.one_of(
    st.floats(allow_nan=False, allow_infinity=False),
    st.integers(-(2**53), 2**53),
    st.text(st.characters(exclude_categories=["C"], exclude_characters="\ufeff"), max_size=20),
)


@settings(max_examples=25)
@given(st.dictionaries(st.from_regex(r"[a-z]+\.[a-z_]+", fullmatch=True), scalars, min_size=1, max_size=4))
def test_every_value_survives(values: dict[str, Any]) -> None:
    new = entry("a: b #c", unsafe=drive("unsafe", values=values))
    text = "suite: 1\nsystems:\n" + _system_text("toy", SYSTEM) + "entries:\n" + _entry_text(new)
    assert parse_suite(yaml.safe_load(text)).entries == [new.entry]


def test_changes_leave_everything_else_as_it_is(file: Path) -> None:
    text = file.read_text().replace("- name: two", "# two is famous\n- name: two")
    file.write_text(text)
    rename_entry(file, "three", "a: new name")
    renamed = text.replace("name: three", "name: 'a: new name'")
    assert file.read_text() == renamed
    other = System(problem="other@2")
    added = add_entries(file, {"toy": SYSTEM, "other": other}, [entry("four", system="other")])
    assert added.systems == {"toy": SYSTEM, "other": other}
    assert [one.name for one in added.entries] == ["one", "two", "a: new name", "four"]
    assert "# two is famous" in file.read_text()
    remove_entries(file, ["four"])
    assert file.read_text() == renamed.replace("entries:", "  other:\n    problem: other@2\nentries:")
    assert [one.name for one in remove_entries(file, ["one", "two"]).entries] == ["a: new name"]


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (
            "    expect: unsafe\n",
            "    expect: maybe\n",
            "line {}: entries[0].unsafe.expect: input should be 'safe' or",
        ),
        (
            "  system: toy\n",
            "  system: toi\n",
            "entries[0].system: expected one of toy, got 'toi' (did you mean 'toy'?)",
        ),
        ("  seed: 7\n", "  sead: 7\n", "line {}: entries[0].sead: unknown field; expected one of"),
        ("    of: 4\n", "    of: 2\n", "entries[0].unsafe: expected unsafe to be at most of, got 4 of 2"),
        (
            "- name: two\n",
            "- name: one\n",
            "entries[1].name: expected each name once; entry 0 is called 'one', too",
        ),
        ("suite: 1\n", "suite: 2\n", "line {}: suite: input should be 1, got 2"),
        ("entries:\n", "entries: [\n", "line "),
    ],
)
def test_a_wrong_hand_edit_is_named_with_its_line(file: Path, old: str, new: str, words: str) -> None:
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new, 1))
    with pytest.raises(InvalidInput) as raised:
        read_suite(file)
    assert str(file) in str(raised.value)
    line = text[: text.index(old)].count("\n") + 1
    assert words.format(line) in str(raised.value)


@pytest.mark.parametrize(
    "change",
    [
        lambda path: remove_entries(path, ["tow"]),
        lambda path: remove_entries(path, ["one", "two", "three"]),
        lambda path: rename_entry(path, "one", "two"),
        lambda path: add_entries(path, {}, [entry("four", system="nobody")]),
    ],
)
def test_what_is_not_there_cannot_be_changed(file: Path, change: Callable[[Path], object]) -> None:
    before = file.read_text()
    with pytest.raises(InvalidInput):
        change(file)
    assert file.read_text() == before, "nothing is half-written"
    assert [one.name for one in file.parent.iterdir()] == [file.name]
