"""Reads OpenSCENARIO XML files that users name: within bounds, without entities, with the line of each element."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final
from xml.parsers import expat

from brink.server.errors import FieldError, InvalidInput
from brink.user_file import read_file

MAX_BYTES: Final = 8 * 1024**2
MAX_LEVELS: Final = 200
_ATTRIBUTE: Final = re.compile(rb"""\s+([^\s=/>]+)\s*=\s*(?:"([^"]*)"|'([^']*)')""")
_TAG: Final = re.compile(rb"<[^\s/>]+")


@dataclass(slots=True, kw_only=True)
class Element:
    """An element of a file.

    Attributes:
        tag: Its name, without a prefix.
        attributes: Its attributes.
        line: Line of its start tag, from 1.
        start: Byte at which its start tag begins.
        children: The elements in it.
        text: The text in it.
    """

    tag: str
    attributes: Mapping[str, str]
    line: int
    start: int
    children: list["Element"] = field(default_factory=list)
    text: str = ""

    def all(self, tag: str) -> list["Element"]:
        """Return the children with a tag."""
        return [one for one in self.children if one.tag == tag]

    def first(self, tag: str) -> "Element | None":
        """Return the first child with a tag; None without one."""
        return next(iter(self.all(tag)), None)

    def descendants(self) -> Iterator["Element"]:
        """Yield all elements in it, in the order of the file."""
        waiting = list(reversed(self.children))
        while waiting:
            yield (one := waiting.pop())
            waiting.extend(reversed(one.children))


@dataclass(frozen=True, slots=True, kw_only=True)
class Document:
    """An OpenSCENARIO file.

    Attributes:
        path: The file.
        data: Its content in UTF-8.
        root: Its root element.
    """

    path: Path
    data: bytes
    root: Element

    def error(self, element: Element | None, message: str) -> InvalidInput:
        """Return the error that an element is not as expected."""
        return InvalidInput([self.field_error(element, message)])

    def field_error(self, element: Element | None, message: str) -> FieldError:
        """Return an error in an element, which names the file, the line and the element."""
        place = str(self.path)
        if element is not None:
            names = (element.attributes.get(name) for name in ("name", "parameterName", "parameterRef"))
            place += f": line {element.line}: {' '.join([element.tag, *filter(None, names)])}"
        return FieldError(pointer="", message=message, place=place)

    def child(self, element: Element, tag: str) -> Element:
        """Return the only child with a tag.

        Raises:
            InvalidInput: There is none, or there are several.
        """
        found = element.all(tag)
        if len(found) != 1:
            raise self.error(element, f"expected one element {tag}, got {len(found)}")
        return found[0]

    def attribute(self, element: Element, name: str) -> str:
        """Return an attribute.

        Raises:
            InvalidInput: It is missing.
        """
        if name not in element.attributes:
            raise self.error(element, f"expected the attribute {name}")
        return element.attributes[name]

    def span(self, element: Element, name: str) -> tuple[int, int]:
        """Return where the value of an attribute begins and ends in `data`, without its quotation marks."""
        tag = _TAG.match(self.data, element.start)
        assert tag is not None
        place = tag.end()
        while match := _ATTRIBUTE.match(self.data, place):
            if match[1].decode() == name:
                return match.span(2 if match[2] is not None else 3)
            place = match.end()
        raise self.error(element, f"expected the attribute {name}")


def read_document(path: Path) -> Document:
    """Read an OpenSCENARIO XML file of version 1.

    Raises:
        InvalidInput: It cannot be read, is not such a file, is too large or nested too deeply, or declares a document
            type, which could hold entities.
    """
    try:
        content = read_file(path, MAX_BYTES)
    except (OSError, ValueError) as error:
        raise InvalidInput.at(
            f"{path}", f"cannot be read: {getattr(error, 'strerror', None) or error}"
        ) from None
    return parse_document(path, content)


def parse_document(path: Path, content: bytes) -> Document:
    """Return the document in the content of a file, as `read_document` does."""
    empty = Document(path=path, data=b"", root=Element(tag="", attributes={}, line=1, start=0))
    try:
        data = content.decode("utf-8-sig").encode()
    except UnicodeDecodeError:
        raise empty.error(None, "expected text in UTF-8") from None
    document = Document(path=path, data=data, root=_parsed(empty, data))
    header = document.root.first("FileHeader")
    if document.root.tag != "OpenSCENARIO" or header is None:
        raise document.error(document.root, "expected the root OpenSCENARIO with a FileHeader")
    if (major := document.attribute(header, "revMajor").strip()) != "1":
        raise document.error(header, f"expected OpenSCENARIO XML 1.0 to 1.3, got revMajor {major!r:.20}")
    return document


def _parsed(document: Document, data: bytes) -> Element:
    parser = expat.ParserCreate("utf-8")
    top = Element(tag="", attributes={}, line=1, start=0)
    opened = [top]

    def start(tag: str, attributes: dict[str, str]) -> None:
        element = Element(
            tag=tag.rpartition(":")[2],
            attributes=attributes,
            line=parser.CurrentLineNumber,
            start=parser.CurrentByteIndex,
        )
        if len(opened) > MAX_LEVELS:
            raise document.error(element, f"expected at most {MAX_LEVELS} levels of elements")
        opened[-1].children.append(element)
        opened.append(element)

    def refuse(*_: Any) -> None:
        place = Element(tag="DOCTYPE", attributes={}, line=parser.CurrentLineNumber, start=0)
        raise document.error(place, "expected no document type and no entities")

    def text(characters: str) -> None:
        opened[-1].text += characters

    parser.StartElementHandler = start
    parser.EndElementHandler = lambda _: opened.pop()
    parser.CharacterDataHandler = text
    parser.buffer_text = True
    parser.StartDoctypeDeclHandler = refuse
    try:
        parser.Parse(data, True)
    except expat.ExpatError as error:
        place = Element(tag="XML", attributes={}, line=error.lineno, start=0)
        raise document.error(place, f"not well-formed: {expat.ErrorString(error.code)}") from None
    return top.children[0]
