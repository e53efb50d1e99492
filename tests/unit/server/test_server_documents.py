"""Documents from users and workers: how much of what is wrong is described, and what is not even read."""

import pytest
from pydantic import BaseModel, ValidationError

from brink.server.documents import MANY_ERRORS, MAX_ERRORS, Body, invalid_input, parse_document, parse_yaml
from brink.server.errors import InvalidInput
from brink.worker.wire import HeartbeatRequest, LeaseRequest


class Words(BaseModel):
    """A model without a bound on its list."""

    words: list[str]


def described(model: type[BaseModel], text: str) -> list[str]:
    """Return the errors of a document."""
    with pytest.raises(ValidationError) as found:
        model.model_validate_json(text, strict=True)
    return [str(error) for error in invalid_input(found.value, model).errors]


@pytest.mark.parametrize(
    ("wrong", "more"), [(MAX_ERRORS, 0), (MAX_ERRORS + 1, 1), (MANY_ERRORS, MANY_ERRORS - MAX_ERRORS)]
)
def test_only_the_first_errors_are_described(wrong: int, more: int) -> None:
    errors = described(Words, f'{{"words": [{", ".join(["1"] * wrong)}]}}')
    assert errors[0] == "words[0]: input should be a valid string, got 1"
    assert errors[MAX_ERRORS:] == ([f"and {more} more invalid fields"] if more else [])


def test_of_very_many_errors_only_their_number_is_told() -> None:
    errors = described(Words, f'{{"words": [{", ".join(["1"] * 5_000)}]}}')
    assert errors == ["expected a Words, got 5000 invalid fields"]


def test_the_length_of_a_list_is_checked_before_its_items() -> None:
    (error,) = described(HeartbeatRequest, f'{{"worker": {{"id": "w"}}, "leases": [{"1, " * 5_000} 1]}}')
    assert "at most 512 items" in error


@pytest.mark.parametrize(("field", "value"), [("max_jobs", '"8"'), ("max_jobs", "true"), ("wait_s", '"1"')])
def test_neither_text_nor_a_truth_value_is_a_number(field: str, value: str) -> None:
    (error,) = described(LeaseRequest, f'{{"worker": {{"id": "w"}}, "capabilities": [], "{field}": {value}}}')
    assert error.startswith(f"{field}: input should be a valid ")


def test_a_document_of_very_many_fields_is_rejected_as_a_whole() -> None:
    class Small(Body):
        size: int = 0

    with pytest.raises(InvalidInput) as found:
        parse_document({f"f{number}": number for number in range(5_000)}, Small, "something small")
    (error,) = found.value.errors
    assert error.message.startswith("expected at most 1 fields, got 5000")
    assert len(error.message) < 300


@pytest.mark.parametrize("text", ["[1, 2, 3, 4, 5]", "a: &a [1, 2]\nb: *a", "&a [*a]", "&a {a: *a}"])
def test_a_yaml_document_of_too_many_values_is_rejected(text: str) -> None:
    with pytest.raises(InvalidInput, match="at most 5 values"):
        parse_yaml(text, max_values=5)


@pytest.mark.parametrize(
    ("text", "document"),
    [
        ("", None),
        ("[1, 2, 3, 4]", [1, 2, 3, 4]),
        ("a: &a [1]\nb: *a", {"a": [1], "b": [1]}),
        ("a: &a {x: 1}\nb: {<<: *a, y: 2}", {"a": {"x": 1}, "b": {"x": 1, "y": 2}}),
    ],
)
def test_a_small_yaml_document_is_read_with_its_aliases(text: str, document: object) -> None:
    assert parse_yaml(text, max_values=7) == document


def test_a_key_given_twice_is_rejected() -> None:
    with pytest.raises(InvalidInput, match="'a' is given twice"):
        parse_yaml("a: 1\nb: 2\na: 3")


@pytest.mark.parametrize(
    "scalar",
    [
        "0x" + "f" * 5_000,
        "-0x" + "f" * 5_000,
        "0b" + "1" * 20_000,
        "0" + "7" * 6_000,
        ":".join(["1"] * 3_000),
        "!!float " + ":".join(["1"] * 2_000),
        "1_" * 4_000,
        "9" * 4_000,
        "!!bool abc",
        "!!bool ''",
        "!!int abc",
        "!!int ''",
        "!!int '-'",
        "!!int 0x",
        "!!float ''",
        "!!float abc",
        "!!timestamp abc",
        "2001-99-99",
        "!!binary 'é'",
        "!!map x",
        "!!seq x",
        "!!set x",
        "!!omap x",
        "!!pairs x",
        "{!!bool x: 1}",
        "{!!map x: 1}",
    ],
)
def test_a_scalar_that_cannot_be_read_is_rejected_with_its_place(scalar: str) -> None:
    for text in (scalar, f"a: {scalar}", f"a: [1, {scalar}]"):
        with pytest.raises(InvalidInput, match=r"line 1, column \d+: ") as found:
            parse_yaml(text)
        assert len(str(found.value)) < 300


def test_a_long_but_readable_number_is_read() -> None:
    assert parse_yaml("[0x" + "f" * 900 + ", 1:30]") == [16**900 - 1, 90]
