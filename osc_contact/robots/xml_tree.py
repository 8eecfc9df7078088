"""The first reader: XML as it must be, every element with its place, nothing repaired.

Expat reads the text; what a URDF never needs (document types, entities, includes, other encodings,
huge or deep trees) ends the reading at once, before any other parser has seen the file.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import NoReturn
from xml.parsers import expat

from osc_contact.robots.findings import ModelFinding, refuse

__all__ = ["MAX_BYTES", "MAX_DEPTH", "MAX_ELEMENTS", "MAX_LINKS", "Element", "read_bytes", "parse"]

MAX_BYTES, MAX_DEPTH, MAX_ELEMENTS = 8 * 2**20, 64, 100_000
MAX_LINKS = 512
"""Most links (joints) of a robot; Pinocchio's reader dies of a few thousand."""
_ENCODING = re.compile(rb"""^\s*<\?xml[^>]*?encoding\s*=\s*["']([^"']*)""")
_KNOWN_ENCODINGS = {b"utf-8", b"utf8", b"us-ascii", b"ascii"}
_WIDE_MARKS = {b"\xff\xfe": "UTF-16", b"\xfe\xff": "UTF-16", b"\x00\x00": "UTF-32"}


@dataclass(slots=True, eq=False)
class Element:
    """An XML element and where it begins (line and column from 1)."""

    tag: str
    attributes: dict[str, str]
    line: int
    column: int
    parent: Element | None = None
    children: list[Element] = field(default_factory=list)
    text: str = ""

    def get(self, key: str, default: str | None = None) -> str | None:
        """An attribute."""
        return self.attributes.get(key, default)

    def find(self, tag: str) -> Element | None:
        """The first child of that tag."""
        return next((child for child in self.children if child.tag == tag), None)

    def findall(self, tag: str) -> list[Element]:
        """The children of that tag."""
        return [child for child in self.children if child.tag == tag]

    def iter(self, tag: str) -> Iterator[Element]:
        """Descendants of that tag, in the order of the file."""
        for child in self.children:
            if child.tag == tag:
                yield child
            yield from child.iter(tag)

    def label(self, key: str = "") -> str:
        """Name for messages: "joint 'turn' <limit effort='0'>"."""
        owner = self
        while owner.tag not in ("link", "joint") and owner.parent is not None:
            owner = owner.parent
        named = f"{owner.tag} {_short(owner.get('name', ''))}" if owner.get("name") else ""
        if owner is self and not key:
            return named or f"<{self.tag}>"
        value = f" {key}={_short(self.get(key))}" if key in self.attributes else ""
        own = f"<{self.tag}{value}>"
        return f"{named} {own}" if named and owner is not self else named + value or own


def read_bytes(file: Path) -> bytes:
    """The content of a regular file that is not too large; anything else is refused."""
    if not file.is_file():
        words = "is not a file" if file.exists() else "does not exist"
        refuse([ModelFinding("file", file, 0, 0, "", words, "")])
    try:
        with file.open("rb") as stream:
            data = stream.read(MAX_BYTES + 1)
    except OSError as error:
        refuse([ModelFinding("file", file, 0, 0, "", f"cannot be read: {error.strerror}", "")])
    if len(data) > MAX_BYTES:
        _stop(file, "file", 0, 0, f"is larger than {MAX_BYTES // 2**20} MiB",
              "keep meshes in files of their own")  # fmt: skip
    return data


def parse(file: Path, data: bytes) -> Element:
    """The root <robot> of a URDF text.

    Raises:
        ModelError: empty, not UTF-8, not well-formed or truncated, a DOCTYPE or an entity, an
            include or macro left over, too deep, too many elements, or another root.
    """
    _check_text(file, data)
    stack: list[Element] = []
    roots: list[Element] = []
    count, parts = 0, {"link": 0, "joint": 0}
    parser = expat.ParserCreate()

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal count
        count += 1
        line, column = parser.CurrentLineNumber, parser.CurrentColumnNumber + 1
        if len(stack) >= MAX_DEPTH:
            _stop(file, "xml", line, column, f"<{tag}> is nested more than {MAX_DEPTH} deep",
                  "a URDF needs about 6 levels")  # fmt: skip
        if count > MAX_ELEMENTS:
            _stop(file, "xml", line, column, f"more than {MAX_ELEMENTS} elements", "split the file")
        if len(stack) == 1 and tag in parts:
            parts[tag] += 1
            if parts[tag] > MAX_LINKS:
                _stop(file, "xml", line, column, f"more than {MAX_LINKS} {tag}s",
                      "split the robot or drop what does not move")  # fmt: skip
        prefix, colon, name = tag.partition(":")
        if colon and (prefix == "xacro" or name == "include"):
            _stop(file, "xml", line, column, f"<{tag}> is not URDF",
                  "expand macros and includes first (xacro in.xacro > out.urdf)")  # fmt: skip
        element = Element(tag, attributes, line, column, stack[-1] if stack else None)
        (stack[-1].children if stack else roots).append(element)
        stack.append(element)

    def end(tag: str) -> None:
        stack.pop()

    def text(data: str) -> None:
        if stack:
            stack[-1].text += data

    def doctype(name: str, system: str | None, public: str | None, internal: int) -> None:
        _stop(file, "xml", parser.CurrentLineNumber, parser.CurrentColumnNumber + 1,
              "<!DOCTYPE> is refused: a robot needs no document type and no entities",
              "delete it and write entities out")  # fmt: skip

    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.StartDoctypeDeclHandler, parser.CharacterDataHandler = doctype, text
    parser.buffer_text = True
    try:
        parser.Parse(data, True)
    except expat.ExpatError as error:
        reason = f"not well-formed XML: {expat.ErrorString(error.code)}"
        opened = stack[-1] if stack else None
        if opened is not None:
            reason += f" inside <{opened.tag}> of line {opened.line}"
        cut = data.count(b"\n") + 1 <= error.lineno and bool(stack or not roots)
        cure = "the file seems to be cut off" if cut else "repair it; nothing is guessed"
        _stop(file, "xml", error.lineno, error.offset + 1, reason, cure)
    root = roots[0]
    if root.tag != "robot":
        _stop(file, "xml", root.line, root.column,
              f"the root element is <{root.tag}>, a URDF begins with <robot>",
              "convert SDF or MJCF files to URDF")  # fmt: skip
    return root


def _check_text(file: Path, data: bytes) -> None:
    if not data.strip():
        _stop(file, "xml", 0, 0, "is empty", "")
    wide = _WIDE_MARKS.get(data[:2])
    if wide:
        _stop(file, "xml", 1, 1, f"is encoded in {wide}", "save it as UTF-8")
    if (at := data.find(b"\0")) >= 0:
        _stop(file, "xml", *_place(data, at), "NUL byte: this is not text", "is it the right file?")
    declared = _ENCODING.match(data[3:] if data.startswith(b"\xef\xbb\xbf") else data)
    if declared and declared[1].lower() not in _KNOWN_ENCODINGS:
        name = declared[1].decode("ascii", "replace")
        _stop(file, "xml", 1, 1, f"declares the encoding {_short(name)}", "save it as UTF-8")
    try:
        data.decode("utf-8")
    except UnicodeDecodeError as error:
        _stop(file, "xml", *_place(data, error.start),
              f"byte 0x{data[error.start]:02x} is not UTF-8", "save it as UTF-8")  # fmt: skip


def _place(data: bytes, at: int) -> tuple[int, int]:
    return data.count(b"\n", 0, at) + 1, at - data.rfind(b"\n", 0, at)


def _short(text: str | None, length: int = 60) -> str:
    text = text or ""
    return repr(text if len(text) <= length else text[:length] + "…")


def _stop(file: Path, check: str, line: int, column: int, reason: str, cure: str) -> NoReturn:
    refuse([ModelFinding(check, file, line, column, "", reason, cure)])
