"""The reference page of the Python interface is what its docstrings say, and lists everything that is public."""

from support.python_reference import GROUPS, PAGE, page

import brink
import brink.guard


def test_the_page_is_up_to_date() -> None:
    assert PAGE.read_text(encoding="utf-8") == page(), "run: make reference"


def test_the_page_lists_every_public_name() -> None:
    listed = {name for names in GROUPS.values() for name in names}
    assert set(brink.__all__) | {f"guard.{name}" for name in brink.guard.__all__} <= listed


def test_public_names_are_found_without_importing_them_first() -> None:
    assert set(brink.__all__) <= set(dir(brink))
    for name in brink.__all__:
        assert getattr(brink, name) is not None
