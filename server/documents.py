"""Reads documents from users: strict models, YAML, and an error for each invalid field.

Every error has a JSON pointer to the field, what was expected, what was given, and the most similar valid name.
"""

import hashlib
import json
import reprlib
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar, get_args

import yaml
from pydantic import BaseModel, ConfigDict, ValidationError, model_validator

from brink.server.errors import FieldError, InvalidInput, nearest
from brink.user_file import read_text

MAX_FILE_BYTES = 1024 * 1024
MAX_VALUES = 100_000
"""Maximum number of values in a YAML file."""
MAX_ERRORS = 50
"""Maximum number of invalid fields that are described; a person corrects the first ones and tries again."""
MANY_ERRORS = 1_000
"""Where there are more, none is described, since a document with so many was not written for this model."""
LONGEST_NUMBER = 1_000
"""Maximum number of characters of a number in a YAML file. JSON's are limited by Python. Longer ones take seconds to
read, in hexadecimal, and cannot be written in a message."""
LONGEST_SHOWN = 120
"""Maximum number of characters of an invalid value in a message."""

Model = TypeVar("Model", bound=BaseModel)


class Body(BaseModel):
    """Base class of all request bodies: strict types, no unknown fields."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    @model_validator(mode="before")
    @classmethod
    def _check_few_fields(cls, given: object) -> object:
        """Reject a document with very many fields at once, rather than with an error for each."""
        if isinstance(given, Mapping) and len(given) > MANY_ERRORS:
            raise ValueError(f"expected at most {len(cls.model_fields)} fields, got {len(given)}")
        return given


def check_printable(text: str) -> str:
    """Return a text if it can be printed on one line.

    Raises:
        ValueError: The text contains control characters.
    """
    if not text.isprintable():
        raise ValueError("expected text without control characters")
    return text


def hash_document(document: object) -> str:
    """Return the SHA-256 of a JSON document, independent of the order of its keys."""
    text = json.dumps(document, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def parse_document(document: object, model: type[Model], expected: str) -> Model:
    """Validate a document.

    Args:
        document: The document, as read from JSON or YAML.
        model: The model it must satisfy.
        expected: A description of the model for the error message.

    Raises:
        InvalidInput: With a pointer to each invalid field.
    """
    if not isinstance(document, Mapping):
        came = "nothing" if document is None else f"a {type(document).__name__}"
        raise InvalidInput.at("", f"expected {expected}, got {came}")
    try:
        return model.model_validate(dict(document))
    except ValidationError as error:
        raise invalid_input(error, model) from None


def read_yaml(path: Path) -> object:
    """Read a YAML or JSON file.

    Raises:
        InvalidInput: The file cannot be read, or is not YAML.
    """
    try:
        text = read_text(path, MAX_FILE_BYTES)
    except (OSError, UnicodeDecodeError) as error:
        reason = (error.strerror or str(error)) if isinstance(error, OSError) else "not UTF-8 text"
        raise _unreadable(path, reason) from None
    try:
        return parse_yaml(text)
    except InvalidInput as error:
        raise _unreadable(path, "; ".join(one.message for one in error.errors)) from None


def _unreadable(path: Path, reason: str) -> InvalidInput:
    return InvalidInput([FieldError(pointer="", message=reason, place=str(path))])


@contextmanager
def errors_in_file(path: Path) -> Iterator[None]:
    """Locate in a YAML file the fields to which an error refers.

    Args:
        path: The file that was read.

    Raises:
        InvalidInput: The errors, with their places in the file.
    """
    try:
        yield
    except InvalidInput as error:
        raise InvalidInput(placed_in_file(error.errors, path)) from None


def placed_in_file(errors: Iterable[FieldError], path: Path) -> list[FieldError]:
    """Return errors with the positions in a YAML file of their fields.

    Args:
        errors: The errors; those that have a place, or are about no field of a document, stay as they are.
        path: The file that was read.
    """
    root = _nodes(path)
    return [
        error
        if error.place or not (error.pointer.startswith("/") or error.pointer == "")
        else replace(error, place=_place(error, path, root))
        for error in errors
    ]


def _nodes(path: Path) -> yaml.Node | None:
    try:
        root: yaml.Node | None = yaml.compose(read_text(path, MAX_FILE_BYTES), yaml.SafeLoader)
    except (OSError, ValueError, RecursionError, yaml.YAMLError):
        return None  # the errors name the file all the same
    return root


def _place(error: FieldError, path: Path, root: yaml.Node | None) -> str:
    """Return the file, the line and the name of a field; the line of its parent if the field is missing."""
    parts = [part.replace("~1", "/").replace("~0", "~") for part in error.pointer.split("/")[1:] if part]
    line, name, node = None, "", root
    for part in parts:
        name += f"[{part}]" if part.isdecimal() and isinstance(node, yaml.SequenceNode) else f".{part}"
        mark, node = _child(node, part)
        line = line if mark is None else mark.line + 1
    told = [
        str(path),
        *([] if line is None else [f"line {line}"]),
        *([name.removeprefix(".")] if name else []),
    ]
    return ": ".join(told)


def _child(node: yaml.Node | None, part: str) -> tuple[yaml.Mark | None, yaml.Node | None]:
    """Return the start of a part of a document, and the part; None if it is missing."""
    if isinstance(node, yaml.MappingNode):
        for key, value in node.value:
            if isinstance(key, yaml.ScalarNode) and key.value == part:
                return key.start_mark, value
    if isinstance(node, yaml.SequenceNode) and part.isdecimal() and int(part) < len(node.value):
        child = node.value[int(part)]
        return child.start_mark, child
    return None, None


def parse_yaml(text: str, *, max_values: int = MAX_VALUES) -> object:
    """Parse YAML or JSON.

    Args:
        text: The text.
        max_values: Maximum number of values in it.

    Raises:
        InvalidInput: The text is not YAML, or has too many values.
    """
    try:
        document = _Loader(text).read(max_values)
    except yaml.YAMLError as error:
        raise InvalidInput.at("", _yaml_problem(error)) from None
    except RecursionError:
        raise InvalidInput.at("", "not YAML: nested too deeply") from None
    return document


class _Loader(yaml.SafeLoader):
    """A YAML loader that rejects ambiguous or oversized input.

    These are duplicate keys, of which YAML would silently use the last, and aliases of aliases, with which a few
    lines stand for billions of values. Every scalar that cannot be read is a `yaml.YAMLError` with its place: PyYAML
    itself raises whatever its conversion happens to raise.
    """

    _max_values = MAX_VALUES
    _values = 0

    def read(self, max_values: int) -> object:
        """Return the document.

        Args:
            max_values: Maximum number of its values.

        Raises:
            yaml.YAMLError: The text is not YAML, or has too many values.
        """
        self._max_values = max_values
        try:
            root = self.get_single_node()
            if root is None:
                return None
            if _count_values(root, max_values, {}) > max_values:
                raise self._too_many(root.start_mark)
            document: object = self.construct_document(root)
            return document
        finally:
            self.dispose()

    def compose_node(self, parent: Any, index: Any) -> yaml.Node | None:
        self._values += 1
        if self._values > 2 * self._max_values:  # keys are nodes, too
            raise self._too_many(self.get_mark())
        node: yaml.Node | None = super().compose_node(parent, index)
        return node

    def construct_object(self, node: yaml.Node, deep: bool = False) -> Any:
        if not isinstance(node, yaml.ScalarNode):
            return super().construct_object(node, deep)
        kind = node.tag.rpartition(":")[2]
        if kind in ("int", "float") and len(node.value) > LONGEST_NUMBER:
            expected = f"expected a number of at most {LONGEST_NUMBER} characters, got {len(node.value)}"
            raise yaml.constructor.ConstructorError(None, None, expected, node.start_mark)
        try:
            return super().construct_object(node, deep)
        except (ArithmeticError, AttributeError, LookupError, ValueError):
            expected = f"expected a value of type {kind}, got {_shown(node.value)}"
            raise yaml.constructor.ConstructorError(None, None, expected, node.start_mark) from None

    def _too_many(self, mark: yaml.Mark) -> yaml.YAMLError:
        expected = f"expected at most {self._max_values} values, counting each alias as its target"
        return yaml.constructor.ConstructorError(None, None, expected, mark)

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        pairs = (
            node.value if isinstance(node, yaml.MappingNode) else []
        )  # a scalar may be tagged as a mapping
        counts = Counter(key.value for key, _ in pairs if isinstance(key, yaml.ScalarNode))
        for key, _ in reversed(pairs):
            if isinstance(key, yaml.ScalarNode) and key.value != "<<" and counts[key.value] > 1:
                raise yaml.constructor.ConstructorError(
                    None, None, f"{key.value!r} is given twice", key.start_mark
                )
        return super().construct_mapping(node, deep)


def _count_values(node: yaml.Node, endless: int, known: dict[yaml.Node, int]) -> int:
    """Return the number of values of a node, counting each alias as its target.

    Args:
        node: The node.
        endless: Count of a node that contains itself.
        known: Counts of the nodes visited before, which is extended.
    """
    if node in known:
        return known[node]
    known[node] = endless
    children: list[yaml.Node] = []
    if isinstance(node, yaml.SequenceNode):
        children = node.value
    elif isinstance(node, yaml.MappingNode):
        children = [one for _, one in node.value]
    known[node] = 1 + sum(_count_values(one, endless, known) for one in children)
    return known[node]


def _yaml_problem(error: yaml.YAMLError) -> str:
    mark = getattr(error, "problem_mark", None)
    if mark is None:
        return f"not YAML: {' '.join(str(error).split())}"
    problem = str(getattr(error, "problem", None) or "cannot be read")
    if "\\t" in problem:
        problem = "a tab; YAML is indented with spaces"
    return f"line {mark.line + 1}, column {mark.column + 1}: {problem}"


def invalid_input(error: ValidationError, model: type[BaseModel], prefix: str = "") -> InvalidInput:
    """Return a validation error as `InvalidInput`.

    Args:
        error: The validation error.
        model: The model that was violated.
        prefix: JSON pointer to the validated part of the document.
    """
    if error.error_count() > MANY_ERRORS:
        return InvalidInput.at(
            prefix, f"expected a {model.__name__}, got {error.error_count()} invalid fields"
        )
    items = error.errors(include_url=False)
    described = [_field_error(item, model, prefix) for item in items[:MAX_ERRORS]]
    return InvalidInput([*described, *_not_described(len(items))])


def field_errors(items: Sequence[Any], model: type[BaseModel] | None) -> list[FieldError]:
    """Return a request's validation errors, whose locations start with ``body``, ``query`` or ``path``."""
    errors = []
    for item in items[:MAX_ERRORS]:
        part, *location = item["loc"]
        body = part == "body"
        relative = {**item, "loc": tuple(location)}
        errors.append(_field_error(relative, (model if body else None) or Body, "" if body else f"/{part}"))
    return errors + _not_described(len(items))


def _not_described(count: int) -> list[FieldError]:
    more = count - MAX_ERRORS
    return [FieldError(pointer="", message=f"and {more} more invalid fields")] if more > 0 else []


def _field_error(item: Any, model: type[BaseModel], prefix: str) -> FieldError:
    location = [part for part in item["loc"] if not isinstance(part, str) or not part.startswith("function-")]
    pointer = prefix + "".join(f"/{_escaped(str(part))}" for part in location)
    if item["type"] == "extra_forbidden":
        valid = sorted(_fields_at(model, location[:-1]))
        return FieldError(
            pointer=pointer,
            message=f"unknown field; expected one of {', '.join(valid) or 'none'}",
            nearest=nearest(str(location[-1]), valid),
        )
    if item["type"] == "missing":
        return FieldError(pointer=pointer, message="missing; this field is required")
    if item["type"] == "json_invalid":
        where = location[-1] if location else 0
        reason = item.get("ctx", {}).get("error", "malformed")
        return FieldError(pointer=prefix, message=f"expected JSON: {reason} at character {where}")
    if item["type"] in ("model_type", "model_attributes_type", "dict_type"):
        valid = sorted(_fields_at(model, location))
        fields = f" with {', '.join(valid)}" if valid else ""
        message = f"expected a mapping{fields}, got {_shown(item['input'])}"
        return FieldError(pointer=pointer, message=message)
    message = item["msg"].removeprefix("Value error, ")
    valid = [str(value) for value in _literals(item)]
    return FieldError(
        pointer=pointer,
        message=f"{message[0].lower()}{message[1:]}, got {_shown(item.get('input'))}",
        nearest=nearest(str(item.get("input")), valid) if valid else None,
    )


def _shown(value: object) -> str:
    """Return a value for a message, truncating a large one."""
    large = isinstance(value, dict | list | str) and len(value) > LONGEST_SHOWN
    return (reprlib.repr(value) if large else repr(value))[:LONGEST_SHOWN]


def _literals(item: Any) -> list[str]:
    expected = item.get("ctx", {}).get("expected", "") if item["type"] == "literal_error" else ""
    return [part.strip().strip("'") for part in expected.replace(" or ", ", ").split(",") if part.strip()]


def _escaped(part: str) -> str:
    return part.replace("~", "~0").replace("/", "~1")


def _fields_at(model: type[BaseModel], location: list[Any]) -> set[str]:
    for part in location:
        if isinstance(part, int):  # an element of a list, whose model is known
            continue
        field = model.model_fields.get(str(part))
        inner = field.annotation if field else None
        for choice in get_args(inner):  # an optional model, or a list of models
            inner = choice if isinstance(choice, type) and issubclass(choice, BaseModel) else inner
        if not (isinstance(inner, type) and issubclass(inner, BaseModel)):
            return set()
        model = inner
    return set(model.model_fields)
