"""Reads documents from users: strict models, YAML, and an error for each invalid field.

Every error has a JSON pointer to the field, what was expected, what was given, and the most similar valid name.
"""

import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar, get_args

import yaml
from pydantic import BaseModel, ConfigDict, ValidationError

from brink.server.errors import FieldError, InvalidInput, nearest

MAX_FILE_BYTES = 1024 * 1024

Model = TypeVar("Model", bound=BaseModel)


class Body(BaseModel):
    """Base class of all request bodies: strict types, no unknown fields."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


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
        if path.stat().st_size > MAX_FILE_BYTES:
            raise _unreadable(path, f"larger than {MAX_FILE_BYTES} bytes")
        text = path.read_text(encoding="utf-8")
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
    """Say where in a YAML file the fields are that an error points to.

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
    """Return errors with the places in a YAML file of the fields that they point to.

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
        root: yaml.Node | None = yaml.compose(path.read_text(encoding="utf-8"), yaml.SafeLoader)
    except (OSError, ValueError, RecursionError, yaml.YAMLError):
        return None  # the errors name the file all the same
    return root


def _place(error: FieldError, path: Path, root: yaml.Node | None) -> str:
    """Return the file, the line and the name of a field; the line of what should contain it if it is missing."""
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
    """Return where a part of a document begins, and the part; None if it is not there."""
    if isinstance(node, yaml.MappingNode):
        for key, value in node.value:
            if isinstance(key, yaml.ScalarNode) and key.value == part:
                return key.start_mark, value
    if isinstance(node, yaml.SequenceNode) and part.isdecimal() and int(part) < len(node.value):
        child = node.value[int(part)]
        return child.start_mark, child
    return None, None


def parse_yaml(text: str) -> object:
    """Parse YAML or JSON.

    Raises:
        InvalidInput: The text is not YAML.
    """
    try:
        document: object = yaml.load(text, _Loader)
    except yaml.YAMLError as error:
        raise InvalidInput.at("", _yaml_problem(error)) from None
    except (ValueError, RecursionError) as error:  # an invalid date; unlimited nesting
        reason = str(error) if isinstance(error, ValueError) else "nested too deeply"
        raise InvalidInput.at("", f"not YAML: {reason}") from None
    return document


class _Loader(yaml.SafeLoader):
    """A YAML loader that rejects duplicate keys, of which YAML would silently use the last."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        keys = [key.value for key, _ in node.value if isinstance(key, yaml.ScalarNode)]
        for key, _ in reversed(node.value):
            if isinstance(key, yaml.ScalarNode) and key.value != "<<" and keys.count(key.value) > 1:
                raise yaml.constructor.ConstructorError(
                    None, None, f"{key.value!r} is given twice", key.start_mark
                )
        return super().construct_mapping(node, deep)


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
    return InvalidInput(_field_error(item, model, prefix) for item in error.errors(include_url=False))


def field_errors(items: Iterable[Any], model: type[BaseModel] | None) -> list[FieldError]:
    """Return a request's validation errors, whose locations start with ``body``, ``query`` or ``path``."""
    errors = []
    for item in items:
        part, *location = item["loc"]
        body = part == "body"
        relative = {**item, "loc": tuple(location)}
        errors.append(_field_error(relative, (model if body else None) or Body, "" if body else f"/{part}"))
    return errors


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
        message = f"expected a mapping{fields}, got {repr(item['input'])[:120]}"
        return FieldError(pointer=pointer, message=message)
    message = item["msg"].removeprefix("Value error, ")
    valid = [str(value) for value in _literals(item)]
    shown = repr(item.get("input"))
    return FieldError(
        pointer=pointer,
        message=f"{message[0].lower()}{message[1:]}, got {shown[:120]}",
        nearest=nearest(str(item.get("input")), valid) if valid else None,
    )


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
