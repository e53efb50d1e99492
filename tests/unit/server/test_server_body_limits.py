"""How many values a body has, counted without parsing it."""

import itertools
import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from brink.server.api.body_limits import ValueCounter

TEXT = st.text(st.sampled_from('ab",[{}]:\\/\n\u00e9\u4e2d'), max_size=12)
DOCUMENTS: st.SearchStrategy[Any] = st.recursive(
    st.none() | st.integers() | TEXT, lambda one: st.lists(one) | st.dictionaries(TEXT, one), max_leaves=20
)


def counted(*parts: bytes) -> int:
    counter = ValueCounter()
    for part in parts:
        counter.add(part)
    return counter.values


def brackets_and_commas(document: Any) -> int:
    """Return how many commas and opening brackets the JSON of a document has outside of strings."""
    if not isinstance(document, dict | list):
        return 0
    items = document.values() if isinstance(document, dict) else document
    return max(1, len(document)) + sum(map(brackets_and_commas, items))


@given(document=DOCUMENTS, cuts=st.lists(st.integers(0, 400), max_size=6), ascii_only=st.booleans())
def test_values_are_counted_outside_of_strings_however_the_text_is_cut(
    document: Any, cuts: list[int], ascii_only: bool
) -> None:
    text = json.dumps(document, ensure_ascii=ascii_only).encode()
    places = [0, *sorted(cuts), len(text)]
    parts = [text[start:end] for start, end in itertools.pairwise(places)]
    assert counted(*parts) == brackets_and_commas(document)


@given(document=DOCUMENTS, encoding=st.sampled_from(["utf-16", "utf-16-be", "utf-16-le", "utf-32"]))
def test_no_encoding_hides_values(document: Any, encoding: str) -> None:
    text = json.dumps(document).encode(encoding)
    assert json.loads(text) == document
    assert counted(text) >= brackets_and_commas(document)


@pytest.mark.parametrize("beginning", [b'["\\"', b'["a\\\\"', b'[\\"', b'{"a":"\\u0022"'])
def test_values_after_odd_beginnings_are_counted_or_never_parsed(beginning: bytes) -> None:
    text = beginning + b',"",' + b"1," * 1000
    with pytest.raises(json.JSONDecodeError) as error:
        json.loads(text)
    assert counted(text) >= text[: error.value.pos].count(b"1,")


def test_a_long_text_is_one_value_and_a_long_list_is_many() -> None:
    assert counted(json.dumps({"message": "so, [they] {said}, " * 100_000}).encode()) == 1
    assert counted(b"[" + b"1," * 200_000 + b"1]") == 200_001
