"""Text of a robot's file as elements with their places, and findings on them.

Expat reads the text: well-formed XML only, every element with its place, nothing is repaired. XML
features that a URDF never needs (document types, entities, includes, other encodings, huge or deep
trees) end the reading at once, before any other parser reads the file.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NoReturn
from xml.parsers import expat

from osc_contact.errors import ModelError

MAX_BYTES = 8 * 2**20  #: largest file of a robot, URDF or MJCF
MAX_DEPTH = 64  #: deepest nesting of elements
MAX_ELEMENTS = 100_000  #: largest number of elements of a file
MAX_LINKS = 512
"""Largest number of links, and of joints; Pinocchio's reader crashes at a few thousand."""
_LARGEST_NUMBER = 1e9
"""Largest length, mass, moment or angle of a robot, in any customary unit."""
_DECIMAL = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?", re.ASCII)
_ENCODING = re.compile(rb"""^\s*<\?xml[^>]*?encoding\s*=\s*["']([^"']*)""")
_KNOWN_ENCODINGS = {b"utf-8", b"utf8", b"us-ascii", b"ascii"}


# Findings: errors of a robot's file, a sentence each; all findings become one exception.


SHOWN = 12
"""Largest number of findings that the message of an error lists; the others are counted."""


@dataclass(frozen=True)
class ModelFinding:
    """Error in a file, with its place, reason and cure.

    Attributes:
        check: name of the check that failed: "file", "xml", "name", "number", "tree", "joint",
            "geometry", "mesh", "limit", "inertia", "mass matrix" or "mjcf".
        file: the file.
        line, column: place in the file, counted from 1; 0 for the file as a whole.
        element: "link 'tip' <mass value='-1'>"; empty for the file as a whole.
        reason: sentence on the error, with numbers.
        cure: sentence on its correction.
    """

    check: str
    file: Path
    line: int
    column: int
    element: str
    reason: str
    cure: str

    def __str__(self) -> str:
        """Message with file, line, element, reason and cure."""
        place = f"{self.file}:{self.line}:{self.column}" if self.line else f"{self.file}"
        text = ": ".join(part for part in (place, self.element, self.reason) if part)
        if self.cure:
            text += f". {self.cure[0].upper()}{self.cure[1:]}"
        return text


def refuse(findings: Sequence[ModelFinding]) -> NoReturn:
    """Raise a `ModelError` with the text of the findings and the attribute `findings`."""
    lines = [str(finding) for finding in findings[:SHOWN]]
    if len(findings) > SHOWN:
        lines.append(f"… and {len(findings) - SHOWN} more")
    error = ModelError("\n".join(lines))
    error.findings = tuple(findings)
    raise error


def refuse_file(
    check: str, file: Path, reason: str, cure: str = "", line: int = 0, column: int = 0
) -> NoReturn:
    """Raise a `ModelError` with one finding about a file, or about a place in it.

    Args:
        check: name of the violated check.
        file: the file.
        reason, cure: sentences on the error and its correction.
        line, column: place in the file, from 1; 0: the whole file.
    """
    refuse([ModelFinding(check, file, line, column, "", reason, cure)])


# The text ----------------------------------------------------------------------------------------


Vector = tuple[float, ...]
_ZERO: Vector = (0.0, 0.0, 0.0)


@dataclass(slots=True, eq=False)
class Element:
    """XML element with its place in the file.

    Attributes:
        tag, attributes, text: content of the element.
        file: the file.
        line, column: place of its beginning, counted from 1.
        findings: errors of the file; all its elements share this list.
        parent, children: related elements.
    """

    tag: str
    attributes: dict[str, str]
    file: Path
    line: int
    column: int
    findings: list[ModelFinding]
    parent: Element | None = None
    children: list[Element] = field(default_factory=list)
    text: str = ""

    def get(self, key: str) -> str:
        """Value of an attribute, "" without it."""
        return self.attributes.get(key, "")

    def findall(self, *tags: str) -> list[Element]:
        """Children with one of the tags."""
        return [child for child in self.children if child.tag in tags]

    def find(self, tag: str) -> Element | None:
        """First child with the tag, None without one."""
        children = self.findall(tag)
        return children[0] if children else None

    def part(self, tag: str) -> Element:
        """First child with the tag; without one, the element itself."""
        child = self.find(tag)
        return self if child is None else child

    def iter(self, tag: str) -> Iterator[Element]:
        """Descendants with the tag, in the order of the file."""
        for child in self.children:
            if child.tag == tag:
                yield child
            yield from child.iter(tag)

    def label(self, key: str = "") -> str:
        """Name of the element for messages, such as "joint 'turn' <limit effort='0'>".

        Args:
            key: attribute to be shown; "": none.
        """
        owner = self
        while owner.tag not in ("link", "joint") and owner.parent is not None:
            owner = owner.parent
        name = owner.get("name")
        owner_name = f"{owner.tag} {_quoted(name)}" if name else ""
        value = f" {key}={_quoted(self.get(key))}" if key in self.attributes else ""
        own_label = f"<{self.tag}{value}>"
        if owner is not self:
            return f"{owner_name} {own_label}".lstrip()
        return f"{owner_name}{value}" if owner_name else own_label

    def finding(self, check: str, reason: str, cure: str = "", key: str = "") -> ModelFinding:
        """Finding about the element, or about one of its attributes.

        Args:
            check: name of the check that failed.
            reason, cure: sentences on the error and its correction.
            key: attribute; "": the element as a whole.
        """
        return ModelFinding(check, self.file, self.line, self.column, self.label(key), reason, cure)

    def note(self, check: str, reason: str, cure: str = "", key: str = "") -> None:
        """Append a finding about the element, or about one of its attributes, to `findings`.

        Args:
            check: name of the check that failed.
            reason, cure: sentences on the error and its correction.
            key: attribute; "": the element as a whole.
        """
        self.findings.append(self.finding(check, reason, cure, key))

    def number(self, key: str, default: float | None = None) -> float:
        """Value of an attribute as a finite number; an error is noted, and 0 returned.

        Args:
            key: attribute.
            default: value of a missing attribute; None: the attribute must be there.
        """
        if key in self.attributes:
            return self.value(key, self.get(key).strip())
        if default is not None:
            return default
        self.note("number", f"{key} is missing", f'write {key}="…"')
        return 0.0

    def vector(self, key: str, default: Vector | None = None) -> Vector:
        """Value of an attribute as three finite numbers; an error is noted, and 0 returned.

        Args:
            key: attribute.
            default: value of a missing attribute; None: the attribute must be there.
        """
        if key not in self.attributes and default is not None:
            return default
        text = self.get(key)
        parts = text.split()
        if len(parts) != 3:
            reason = f"{key} has {len(parts)} numbers, 3 are expected"
            self.note("number", reason, _advice_on(text) or f'write {key}="x y z"', key)
            return _ZERO
        return tuple(self.value(key, part) for part in parts)

    def value(self, key: str, text: str) -> float:
        """Value of a text as a finite number; an error is noted, and 0 returned.

        Args:
            key: name of the number for messages, the attribute or the element's tag.
            text: text of the number.
        """
        value = float(text) if _DECIMAL.fullmatch(text) else math.nan
        if not math.isfinite(value):
            reason = f"{key} = {text[:40]!r} is not a finite number"
            cure = _advice_on(text) or "write a decimal number such as 0.25"
        elif abs(value) > _LARGEST_NUMBER and self.tag != "limit":
            reason = f"{key} = {value:g} is beyond ±{_LARGEST_NUMBER:g}"
            cure = "lengths are in m, masses in kg, angles in rad"
        else:
            return value
        self.note("number", reason, cure, key)
        return 0.0

    def origin(self) -> dict[str, Vector]:
        """Vectors "xyz" (m) and "rpy" (rad) of the <origin> of the element, zero without one."""
        origin = self.find("origin")
        if origin is None:
            return {"xyz": _ZERO, "rpy": _ZERO}
        return {"xyz": origin.vector("xyz", _ZERO), "rpy": origin.vector("rpy", _ZERO)}


def _advice_on(text: str) -> str:
    """Advice on a text that is not a number: macros left over, or decimal commas; "" for others."""
    if "${" in text:
        return "expand the macros first (xacro in.xacro > out.urdf)"
    if "," in text:
        return "decimals are written with a point, numbers parted by blanks"
    return ""


def read_bytes(file: Path) -> bytes:
    """Content of a regular file of at most `MAX_BYTES`.

    Raises:
        ModelError: the file does not exist, cannot be read, or is larger.
    """
    if not file.is_file():
        refuse_file("file", file, "is not a file" if file.exists() else "does not exist")
    try:
        with file.open("rb") as stream:
            data = stream.read(MAX_BYTES + 1)
    except OSError as error:
        refuse_file("file", file, f"cannot be read: {error.strerror}")
    if len(data) > MAX_BYTES:
        reason = f"is larger than {MAX_BYTES // 2**20} MiB"
        refuse_file("file", file, reason, "keep meshes in separate files")
    return data


def parse(file: Path, data: bytes) -> Element:
    """Parse the text of a URDF; return its root element <robot>.

    Args:
        file: name of the file, for messages.
        data: its content.

    Raises:
        ModelError: an empty text, not UTF-8, not well-formed or truncated, a DOCTYPE or an entity,
            an include or macro left over, too deep, too many elements, or another root.
    """
    _check_text(file, data)
    root = _Reader(file).read(data)
    if root.tag != "robot":
        reason = f"the root element is <{root.tag}>, a URDF begins with <robot>"
        cure = "convert SDF to URDF; an MJCF file is not called .urdf, but .xml"
        refuse_file("xml", file, reason, cure, root.line, root.column)
    return root


class _Reader:
    """Handlers of expat that build the tree of elements and refuse unusual XML."""

    def __init__(self, file: Path) -> None:
        """Prepare a parser.

        Args:
            file: name of the file, for messages.
        """
        self.file = file
        self.open: list[Element] = []  # elements whose end has not been read, outermost first
        self.roots: list[Element] = []
        self.findings: list[ModelFinding] = []
        self.elements = 0
        self.counts = Counter[str]()  # of links and joints
        self.parser = expat.ParserCreate()
        self.parser.StartElementHandler = self.start
        self.parser.EndElementHandler = self.end
        self.parser.StartDoctypeDeclHandler = self.doctype
        self.parser.CharacterDataHandler = self.text
        self.parser.buffer_text = True

    def read(self, data: bytes) -> Element:
        """Parse a text; return its root element.

        Args:
            data: content of the file.

        Raises:
            ModelError: XML that is not well-formed, or refused by a handler.
        """
        try:
            self.parser.Parse(data, True)
        except expat.ExpatError as error:
            reason = f"not well-formed XML: {expat.ErrorString(error.code)}"
            if self.open:
                reason += f" inside <{self.open[-1].tag}> of line {self.open[-1].line}"
            at_end = data.count(b"\n") + 1 <= error.lineno
            if at_end and (self.open or not self.roots):
                cure = "the file seems to be cut off"
            else:
                cure = "repair it; nothing is guessed"
            refuse_file("xml", self.file, reason, cure, error.lineno, error.offset + 1)
        return self.roots[0]

    def start(self, tag: str, attributes: dict[str, str]) -> None:
        """Handle the beginning of an element: append it to its parent, and make it the open one.

        Args:
            tag: name of the element.
            attributes: texts of its attributes by name.
        """
        # limits that protect the memory from files made to exhaust it
        self.elements += 1
        if len(self.open) >= MAX_DEPTH:
            self.stop(
                f"<{tag}> is nested more than {MAX_DEPTH} deep", "a URDF needs about 6 levels"
            )
        if self.elements > MAX_ELEMENTS:
            self.stop(f"more than {MAX_ELEMENTS} elements", "split the file")
        if len(self.open) == 1 and tag in ("link", "joint"):
            self.counts[tag] += 1
            if self.counts[tag] > MAX_LINKS:
                self.stop(
                    f"more than {MAX_LINKS} {tag}s", "split the robot or drop what does not move"
                )
        # macros and includes would have to be expanded by another program
        prefix, colon, name = tag.partition(":")
        if colon and (prefix == "xacro" or name == "include"):
            cure = "expand macros and includes first (xacro in.xacro > out.urdf)"
            self.stop(f"<{tag}> is not URDF", cure)
        parent = self.open[-1] if self.open else None
        line, column = self.place()
        element = Element(tag, attributes, self.file, line, column, self.findings, parent)
        if parent is None:
            self.roots.append(element)
        else:
            parent.children.append(element)
        self.open.append(element)

    def end(self, tag: str) -> None:
        """Handle the end of an element."""
        self.open.pop()

    def text(self, data: str) -> None:
        """Handle text between tags."""
        if self.open:
            self.open[-1].text += data

    def doctype(
        self, name: str, system: str | None, public: str | None, has_subset: bool
    ) -> NoReturn:
        """Refuse <!DOCTYPE>; expat calls it with the parts of the declaration."""
        reason = "<!DOCTYPE> is refused: a robot needs no document type and no entities"
        self.stop(reason, "delete it and write entities out")

    def place(self) -> tuple[int, int]:
        """Line and column that are read now, counted from 1."""
        return (self.parser.CurrentLineNumber, self.parser.CurrentColumnNumber + 1)

    def stop(self, reason: str, cure: str) -> NoReturn:
        """Raise a `ModelError` about the place that is read now.

        Args:
            reason, cure: sentences on the error and its correction.
        """
        line, column = self.place()
        refuse_file("xml", self.file, reason, cure, line, column)


def _check_text(file: Path, data: bytes) -> None:
    """Refuse content that is not UTF-8 text.

    Args:
        file: name of the file, for messages.
        data: its content.

    Raises:
        ModelError: the content is empty, not UTF-8, or declares another encoding.
    """

    def stop(reason: str, at: int) -> NoReturn:
        """Raise a `ModelError` about the byte at an index, with its line and column."""
        line = data.count(b"\n", 0, at) + 1
        refuse_file("xml", file, reason, "save it as UTF-8", line, at - data.rfind(b"\n", 0, at))

    if not data.strip():
        refuse_file("xml", file, "is empty")
    if (at := data.find(b"\0")) >= 0:
        stop("NUL byte: this is not text, or UTF-16", at)
    declared = _ENCODING.match(data.removeprefix(b"\xef\xbb\xbf"))
    if declared and declared[1].lower() not in _KNOWN_ENCODINGS:
        stop(f"declares the encoding {_quoted(declared[1].decode('ascii', 'replace'))}", 0)
    try:
        data.decode()
    except UnicodeDecodeError as error:
        stop(f"byte 0x{data[error.start]:02x} is not UTF-8", error.start)


def _quoted(text: str) -> str:
    """Text in quotes, cut off after 60 characters, for messages."""
    return repr(text if len(text) <= 60 else f"{text[:60]}…")
