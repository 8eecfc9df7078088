"""A URDF as data: from XML to links and joints with numbers; every word and number is checked.

Words that look like a misspelt word of URDF are refused, because every reader would skip them in
silence. Extensions of simulators (gazebo, …) are passed over; of transmissions only rotor inertia
and gear ratio are read.

Expat reads the text: XML as it must be, every element with its place, nothing repaired. What a URDF
never needs (document types, entities, includes, other encodings, huge or deep trees) ends the
reading at once, before any other parser has seen the file.
"""

from __future__ import annotations

import difflib
import math
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import Any, NamedTuple, NoReturn, TypeVar
from xml.parsers import expat

from osc_contact.errors import ModelError, did_you_mean

MAX_BYTES = 8 * 2**20  #: of a robot's file, URDF or MJCF
MAX_DEPTH = 64
MAX_ELEMENTS = 100_000
MAX_LINKS = 512
"""Most links (joints) of a robot; Pinocchio's reader crashes at a few thousand."""
_HUGE = 1e9
"""No length, mass, moment or angle of a robot is larger, in any unit anybody uses."""
_DECIMAL = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?", re.ASCII)
_ENCODING = re.compile(rb"""^\s*<\?xml[^>]*?encoding\s*=\s*["']([^"']*)""")
_KNOWN_ENCODINGS = {b"utf-8", b"utf8", b"us-ascii", b"ascii"}


# What is wrong with a robot: one finding, one sentence; all findings become one error.


SHOWN = 12
"""So many findings, or names, go into the text of an error; the rest is counted."""


@dataclass(frozen=True)
class ModelFinding:
    """One thing wrong with a file.

    Attributes:
        check: which check failed: "file", "xml", "name", "number", "tree", "joint", "geometry",
            "mesh", "limit", "inertia", "mass matrix" or "mjcf".
        file: the URDF. line, column: where, from 1; 0 where no place in the file is to blame.
        element: "link 'tip' <mass value='-1'>"; empty for the file as a whole.
        reason: what is wrong, with the numbers. cure: what to do about it.
    """

    check: str
    file: Path
    line: int
    column: int
    element: str
    reason: str
    cure: str

    def __str__(self) -> str:
        place = f"{self.file}:{self.line}:{self.column}" if self.line else f"{self.file}"
        return ": ".join(part for part in (place, self.element, self.reason) if part) + (
            f". {self.cure[0].upper()}{self.cure[1:]}" if self.cure else ""
        )


def refuse(findings: Sequence[ModelFinding]) -> NoReturn:
    """Raise a `ModelError` with the text of all findings, which carries them as `findings`."""
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
        check, file, reason, cure, line, column: of the `ModelFinding`.
    """
    refuse([ModelFinding(check, file, line, column, "", reason, cure)])


# The text ----------------------------------------------------------------------------------------


Vector = tuple[float, ...]
_ZERO: Vector = (0.0, 0.0, 0.0)


@dataclass(slots=True, eq=False)
class Element:
    """An XML element and where it begins (line and column from 1).

    `findings`: what is wrong with the file, shared by all elements.
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
        """An attribute, "" where there is none."""
        return self.attributes.get(key, "")

    def findall(self, *tags: str) -> list[Element]:
        """The children of those tags."""
        return [child for child in self.children if child.tag in tags]

    def find(self, tag: str) -> Element | None:
        """The first child of that tag."""
        return next(iter(self.findall(tag)), None)

    def part(self, tag: str) -> Element:
        """The first child of that tag; without one, the element itself."""
        return self.find(tag) or self

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
        named = f"{owner.tag} {_short(owner.get('name'))}" if owner.get("name") else ""
        value = f" {key}={_short(self.get(key))}" if key in self.attributes else ""
        own = f"<{self.tag}{value}>"
        return f"{named} {own}" if named and owner is not self else named + value or own

    def finding(self, check: str, reason: str, cure: str = "", key: str = "") -> ModelFinding:
        """What is wrong with the element (or with its attribute `key`).

        Args:
            check: that failed. reason, cure: sentences. key: attribute.
        """
        place = (self.file, self.line, self.column, self.label(key))
        return ModelFinding(check, *place, reason, cure)

    def note(self, check: str, reason: str, cure: str = "", key: str = "") -> None:
        """Note a `finding`.

        Args:
            check, reason, cure, key: of the finding.
        """
        self.findings.append(self.finding(check, reason, cure, key))

    def number(self, key: str, default: float | None = None) -> float:
        """A finite number; without default it must be there.

        Args:
            key: attribute. default: if absent.
        """
        if key in self.attributes:
            return self.value(key, self.get(key).strip())
        if default is None:
            self.note("number", f"{key} is missing", f'write {key}="…"')
        return default or 0.0

    def vector(self, key: str, default: Vector | None = None) -> Vector:
        """Three finite numbers.

        Args:
            key: attribute. default: if absent.
        """
        if key not in self.attributes and default is not None:
            return default
        text = self.get(key)
        parts = text.split()
        if len(parts) != 3:
            reason = f"{key} has {len(parts)} numbers, 3 are expected"
            self.note("number", reason, _comma(text) or f'write {key}="x y z"', key)
            return _ZERO
        return tuple(self.value(key, part) for part in parts)

    def value(self, key: str, text: str) -> float:
        """The finite number that a text stands for.

        Args:
            key: attribute, or the element's tag. text: to read.
        """
        value = float(text) if _DECIMAL.fullmatch(text) else math.nan
        if not math.isfinite(value):
            reason = f"{key} = {text[:40]!r} is not a finite number"
            cure = _comma(text) or "write a decimal number such as 0.25"
        elif abs(value) > _HUGE and self.tag != "limit":
            reason = f"{key} = {value:g} is beyond ±{_HUGE:g}"
            cure = "lengths are in m, masses in kg, angles in rad"
        else:
            return value
        self.note("number", reason, cure, key)
        return 0.0

    def origin(self) -> dict[str, Vector]:
        """xyz (m) and rpy (rad) of the <origin> of the element."""
        origin = self.find("origin")
        return {
            key: _ZERO if origin is None else origin.vector(key, _ZERO) for key in ("xyz", "rpy")
        }


def _comma(text: str) -> str:
    if "${" in text:
        return "expand the macros first (xacro in.xacro > out.urdf)"
    return "decimals are written with a point, numbers parted by blanks" if "," in text else ""


def read_bytes(file: Path) -> bytes:
    """The content of a regular file that is not too large; anything else is refused."""
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
    """The root <robot> of a URDF text.

    Raises:
        ModelError: empty, not UTF-8, not well-formed or truncated, a DOCTYPE or an entity, an
            include or macro left over, too deep, too many elements, or another root.
    """
    _check_text(file, data)
    stack: list[Element] = []
    roots: list[Element] = []
    findings: list[ModelFinding] = []
    counts = Counter[str]()
    parser = expat.ParserCreate()

    def stop(reason: str, cure: str) -> NoReturn:
        place = (parser.CurrentLineNumber, parser.CurrentColumnNumber + 1)
        refuse_file("xml", file, reason, cure, *place)

    def start(tag: str, attributes: dict[str, str]) -> None:
        counts[""] += 1
        if len(stack) >= MAX_DEPTH:
            stop(f"<{tag}> is nested more than {MAX_DEPTH} deep", "a URDF needs about 6 levels")
        if counts[""] > MAX_ELEMENTS:
            stop(f"more than {MAX_ELEMENTS} elements", "split the file")
        if len(stack) == 1 and tag in ("link", "joint"):
            counts[tag] += 1
            if counts[tag] > MAX_LINKS:
                stop(f"more than {MAX_LINKS} {tag}s", "split the robot or drop what does not move")
        prefix, colon, name = tag.partition(":")
        if colon and (prefix == "xacro" or name == "include"):
            cure = "expand macros and includes first (xacro in.xacro > out.urdf)"
            stop(f"<{tag}> is not URDF", cure)
        place = (parser.CurrentLineNumber, parser.CurrentColumnNumber + 1)
        above = stack[-1] if stack else None
        element = Element(tag, attributes, file, *place, findings, above)
        (roots if above is None else above.children).append(element)
        stack.append(element)

    def text(data: str) -> None:
        if stack:
            stack[-1].text += data

    def doctype(*declared: Any) -> None:
        reason = "<!DOCTYPE> is refused: a robot needs no document type and no entities"
        stop(reason, "delete it and write entities out")

    parser.StartElementHandler = start
    parser.EndElementHandler = lambda tag: stack.pop()
    parser.StartDoctypeDeclHandler = doctype
    parser.CharacterDataHandler = text
    parser.buffer_text = True
    try:
        parser.Parse(data, True)
    except expat.ExpatError as error:
        reason = f"not well-formed XML: {expat.ErrorString(error.code)}"
        if stack:
            reason += f" inside <{stack[-1].tag}> of line {stack[-1].line}"
        cut = data.count(b"\n") + 1 <= error.lineno and (stack or not roots)
        cure = "the file seems to be cut off" if cut else "repair it; nothing is guessed"
        refuse_file("xml", file, reason, cure, error.lineno, error.offset + 1)
    root = roots[0]
    if root.tag != "robot":
        reason = f"the root element is <{root.tag}>, a URDF begins with <robot>"
        cure = "convert SDF to URDF; an MJCF file is not called .urdf, but .xml"
        refuse_file("xml", file, reason, cure, root.line, root.column)
    return root


def _check_text(file: Path, data: bytes) -> None:
    """Refuse what is not UTF-8 text."""

    def stop(reason: str, at: int) -> NoReturn:
        line = data.count(b"\n", 0, at) + 1
        refuse_file("xml", file, reason, "save it as UTF-8", line, at - data.rfind(b"\n", 0, at))

    if not data.strip():
        refuse_file("xml", file, "is empty")
    if (at := data.find(b"\0")) >= 0:
        stop("NUL byte: this is not text, or UTF-16", at)
    declared = _ENCODING.match(data.removeprefix(b"\xef\xbb\xbf"))
    if declared and declared[1].lower() not in _KNOWN_ENCODINGS:
        stop(f"declares the encoding {_short(declared[1].decode('ascii', 'replace'))}", 0)
    try:
        data.decode()
    except UnicodeDecodeError as error:
        stop(f"byte 0x{data[error.start]:02x} is not UTF-8", error.start)


def _short(text: str) -> str:
    return repr(text if len(text) <= 60 else f"{text[:60]}…")


MOMENTS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
LIMITS = ("lower", "upper", "effort", "velocity")
MAX_NAME = 256
_KINDS = ("revolute", "continuous", "prismatic", "fixed")

_CHILDREN = {
    "robot": ("link", "joint", "material", "transmission", "gazebo"),
    "link": ("inertial", "visual", "collision"),
    "joint": (
        "parent",
        "child",
        "origin",
        "axis",
        "limit",
        "dynamics",
        "mimic",
        "safety_controller",
        "calibration",
    ),
    "inertial": ("origin", "mass", "inertia"),
}
_ONCE = {
    "link": ("inertial",),
    "joint": _CHILDREN["joint"],
    "inertial": _CHILDREN["inertial"],
    "visual": ("origin", "geometry"),
    "collision": ("origin", "geometry"),
}
_ATTRIBUTES = {
    "origin": ("xyz", "rpy"),
    "axis": ("xyz",),
    "parent": ("link",),
    "child": ("link",),
    "mass": ("value",),
    "inertia": MOMENTS,
    "mimic": ("joint", "multiplier", "offset"),
}


Numbers = dict[str, Any]  #: attributes of an element as numbers


class Inertial(NamedTuple):
    """Mass (kg), origin xyz (m) rpy (rad) of the centre of mass, moments ixx … izz (kg m²)."""

    mass: float
    origin: Numbers
    moments: Numbers
    element: Element


class Link(NamedTuple):
    """A link as written."""

    name: str
    inertial: Inertial | None
    element: Element


class Joint(NamedTuple):
    """A joint as written; `limits` holds what numbers its <limit> has."""

    name: str
    kind: str
    parent: str
    child: str
    origin: Numbers
    axis: Vector
    limits: Numbers
    losses: Numbers
    mimic: str | None
    element: Element


Part = TypeVar("Part", Link, Joint)


@dataclass(slots=True, eq=False)
class Document:
    """A URDF; the elements of `root` note what is wrong with it.

    `rotors`: by joint, inertia of its motor's rotor (kg m²) and gear ratio, from transmissions.
    """

    file: Path
    name: str
    root: Element
    links: dict[str, Link] = field(default_factory=dict)
    joints: dict[str, Joint] = field(default_factory=dict)
    rotors: dict[str, tuple[float, float]] = field(default_factory=dict)

    def require(self) -> None:
        """Raise what was found, if anything."""
        if self.root.findings:
            refuse(self.root.findings)


def read_document(file: Path, data: bytes) -> Document:
    """Links and joints of a URDF text; its elements note what is wrong with them.

    Raises:
        ModelError: the text is not the XML of a robot at all, or has more than 512 links.
    """
    root = parse(file, data)
    document = Document(file, root.get("name"), root)
    if not document.name:
        root.note("name", "the robot has no name", 'write <robot name="…">')
    _check_words(root)
    for element in root.findall("link"):
        inertial = element.find("inertial")
        read = None if inertial is None else _inertial(inertial)
        _keep(document.links, Link(element.get("name"), read, element))
    if not document.links:
        root.note("tree", "the robot has no link")
    for element in root.findall("joint"):
        _keep(document.joints, _joint(element))
    for element in root.findall("transmission"):
        joints = element.findall("joint")
        if len(joints) == len(element.findall("actuator")) == 1:
            document.rotors[joints[0].get("name")] = _rotor(element)
    return document


def _check_words(element: Element) -> None:
    """Note elements and attributes that are misspelt, or twice where one may stand."""
    known = _CHILDREN.get(element.tag, ())
    seen: dict[str, Element] = {}
    for child in element.children:
        tag = child.tag
        first = seen.setdefault(tag, child)
        if tag in _ONCE.get(element.tag, ()) and first is not child:
            child.note("xml", f"a second <{tag}>; the first is in line {first.line}", "delete one")
        misspelt = [] if tag in known else difflib.get_close_matches(tag.lower(), known, 1, 0.8)
        for near in misspelt:
            child.note("xml", f"<{tag}> is no word of URDF", f"did you mean <{near}>?")
        if element.tag in ("joint", "inertial") and (allowed := _ATTRIBUTES.get(tag)):
            cure = f"there is: {', '.join(allowed)}"
            for key in child.attributes:
                if key not in allowed:
                    child.note("xml", f"<{tag}> has no attribute {key!r}", cure)
        if tag in _CHILDREN or tag in _ONCE:
            _check_words(child)


def _rotor(transmission: Element) -> tuple[float, float]:
    """Rotor inertia and gear ratio of a transmission with one joint and one motor."""
    found = {"rotorInertia": 0.0, "mechanicalReduction": 1.0}
    for part in transmission.findall("joint", "actuator"):
        for child in part.findall(*found):
            value = found[child.tag] = child.value(child.tag, child.text.strip())
            if child.tag == "rotorInertia" and value < 0.0:
                child.note("joint", f"rotor inertia {value:g} is negative", "write a value ≥ 0")
    return (found["rotorInertia"], found["mechanicalReduction"])


def _keep(kept: dict[str, Part], one: Part) -> None:
    """Keep a link or a joint under its name, if that name is unique."""
    element = one.element
    name = one.name
    if name in kept and name.strip():
        first = kept[name].element.line
        reason = f"a second {element.tag} of that name; the first is in line {first}"
        element.note("name", reason, "rename one")
        return
    kept[name] = one
    if not name.strip():
        element.note("name", f"a {element.tag} without a name", 'write name="…"')
    elif len(name) > MAX_NAME:
        element.note("name", f"the name has {len(name)} characters", f"use at most {MAX_NAME}")
    elif name == "universe":
        element.note("name", "the name 'universe' means the world in Pinocchio", "rename it")


def _inertial(element: Element) -> Inertial:
    for word in ("mass", "inertia"):
        if element.find(word) is None:
            element.note("inertia", f"<inertial> without <{word}>", f"add <{word}>")
    mass = element.find("mass")
    tensor = element.find("inertia")
    return Inertial(
        0.0 if mass is None else mass.number("value"),
        element.origin(),
        {} if tensor is None else {key: tensor.number(key) for key in MOMENTS},
        element,
    )


def _joint(element: Element) -> Joint:
    kind = element.get("type")
    if kind in ("planar", "floating"):
        cure = "build it from prismatic and revolute joints, or fix it"
        element.note("joint", f"a {kind} joint (nq ≠ nv) is not supported", cure, "type")
    elif kind not in _KINDS:
        reason = "unknown joint type" if kind else "no joint type"
        element.note("joint", reason, did_you_mean(kind, _KINDS), "type")
    for word in ("parent", "child"):
        if element.find(word) is None:
            element.note("tree", f"a joint without <{word}>", f'add <{word} link="…"/>')
    losses = {"damping": 0.0, "friction": 0.0}
    for dynamics in element.findall("dynamics"):
        for key in losses:
            value = losses[key] = dynamics.number(key, 0.0)
            if value < 0:
                reason = f"{key} {value:g} is negative: it would drive the joint"
                dynamics.note("joint", reason, "write a value ≥ 0", key)
    mimic = element.find("mimic")
    if mimic is not None:
        mimic.number("multiplier", 1.0)
        mimic.number("offset", 0.0)
    return Joint(
        element.get("name"),
        kind,
        element.part("parent").get("link"),
        element.part("child").get("link"),
        element.origin(),
        _axis(element, kind),
        {
            key: limit.number(key)
            for limit in element.findall("limit")
            for key in LIMITS
            if key in limit.attributes and kind != "fixed"
        },
        losses,
        None if mimic is None else mimic.get("joint"),
        element,
    )


def _axis(element: Element, kind: str) -> Vector:
    """Unit axis of a joint; (1, 0, 0) where none is given (URDF's default)."""
    axis = element.find("axis")
    if axis is None or kind == "fixed":
        return (1.0, 0.0, 0.0)
    known = len(axis.findings)
    numbers = axis.vector("xyz")
    length = math.hypot(*numbers)
    if len(axis.findings) == known and not abs(length - 1.0) <= 1e-4:
        reason = f"the axis has length {length:.6g}; readers disagree on what that means"
        axis.note("joint", reason, "write a unit vector", "xyz")
    return tuple(x / (length or 1.0) for x in numbers)


# Links and joints form one tree -------------------------------------------------------------------


def check_tree(document: Document) -> None:
    """Note unknown ends, links with two parents, several roots and loops."""
    links = document.links
    above: dict[str, Joint] = {}
    for joint in document.joints.values():
        element = joint.element
        for end in element.findall("parent", "child"):
            name = end.get("link")
            if name not in links:
                reason = f"the {end.tag} link {name!r} does not exist"
                end.note("tree", reason, did_you_mean(name, list(links)[:40]), "link")
        if joint.parent == joint.child:
            reason = f"joins the link {joint.child!r} to itself"
            element.note("tree", reason, "a joint needs two links")
        elif joint.child in above:
            reason = f"the link {joint.child!r} already hangs on joint {above[joint.child].name!r}"
            cure = "close loops as contacts or constraints, not in the URDF"
            element.note("tree", reason, cure)
        above[joint.child] = joint
    if document.root.findings:
        return
    roots = [name for name in links if name not in above]
    if len(roots) > 1:
        listed = ", ".join(map(repr, roots[:5]))
        reason = f"{len(roots)} links have no parent: {listed}; a robot has one root"
        links[roots[1]].element.note("tree", reason, "join them or delete the loose ones")
    try:
        TopologicalSorter({name: [joint.parent] for name, joint in above.items()}).prepare()
    except CycleError as error:
        loop = error.args[1][::-1]  # from each link to its parent
        reason = f"the links {' → '.join(map(repr, loop[:5]))} form a loop"
        above[loop[0]].element.note("tree", reason, "open it; close loops as constraints")


def check_mimics(document: Document) -> None:
    """Note mimic joints that follow nothing, a fixed joint, themselves or each other."""
    joints = document.joints
    for joint in joints.values():
        if joint.mimic is None:
            continue
        mimic = joint.element.part("mimic")
        master = joints.get(joint.mimic)
        if master is None:
            reason = f"follows the joint {joint.mimic!r}, which does not exist"
            mimic.note("joint", reason, did_you_mean(joint.mimic, list(joints)[:40]), "joint")
        elif master.kind == "fixed":
            reason = f"follows the fixed joint {joint.mimic!r}"
            mimic.note("joint", reason, "follow a joint that moves", "joint")
        seen: list[Joint] = []
        while master is not None and master not in seen:
            seen.append(master)
            master = joints.get(master.mimic or "")
        if joint in seen:
            mimic.note("joint", "follows itself", "follow another", "joint")
