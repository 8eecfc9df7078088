"""A URDF as data: from XML to links and joints with numbers; every word and number is checked.

Words that look like a misspelt word of URDF are refused, because every reader would skip them in
silence. Extensions of simulators (gazebo, …) are passed over; of transmissions only rotor inertia
and gear ratio are read.
"""

import difflib
import math
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

from osc_contact.robots.xml_tree import Element, ModelFinding, parse, refuse, suggest

MOMENTS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
LIMITS = ("lower", "upper", "effort", "velocity")
MAX_NAME = 256
_KINDS = ("revolute", "continuous", "prismatic", "fixed")
_HUGE = 1e9
"""No length, mass, moment or angle of a robot is larger, in any unit anybody uses."""
_DECIMAL = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?", re.ASCII)

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

Vector = tuple[float, ...]
_ZERO: Vector = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class Inertial:
    """Mass (kg), pose of the centre of mass (m, rad), moments xx xy xz yy yz zz (kg m²)."""

    mass: float
    xyz: Vector
    rpy: Vector
    moments: Vector
    element: Element


@dataclass(frozen=True, slots=True, eq=False)
class Link:
    """A link as written."""

    name: str
    inertial: Inertial | None
    element: Element


@dataclass(frozen=True, slots=True, eq=False)
class Joint:
    """A joint as written; `limits` holds what numbers its <limit> has."""

    name: str
    kind: str
    parent: str
    child: str
    xyz: Vector
    rpy: Vector
    axis: Vector
    limits: dict[str, float]
    damping: float
    friction: float
    mimic: str | None
    element: Element


Part = TypeVar("Part", Link, Joint)


@dataclass(slots=True, eq=False)
class Document:
    """A URDF whose words and numbers are sound; `findings` holds what is not.

    `rotors`: by joint, inertia of its motor's rotor (kg m²) and gear ratio, from transmissions.
    """

    file: Path
    name: str
    root: Element
    links: dict[str, Link] = field(default_factory=dict)
    joints: dict[str, Joint] = field(default_factory=dict)
    rotors: dict[str, tuple[float, float]] = field(default_factory=dict)
    findings: list[ModelFinding] = field(default_factory=list)

    def finding(
        self, check: str, element: Element, reason: str, cure: str = "", key: str = ""
    ) -> ModelFinding:
        """What is wrong with an element (or with its attribute `key`).

        Args:
            check: that failed. element: at fault. reason, cure: sentences. key: attribute.
        """
        place = (self.file, element.line, element.column, element.label(key))
        return ModelFinding(check, *place, reason, cure)

    def add(self, check: str, element: Element, reason: str, cure: str = "", key: str = "") -> None:
        """Note a `finding`.

        Args:
            check, element, reason, cure, key: of the finding.
        """
        self.findings.append(self.finding(check, element, reason, cure, key))

    def require(self) -> None:
        """Raise what was found, if anything."""
        if self.findings:
            refuse(self.findings)

    # Numbers of an element ----------------------------------------------------------------------

    def number(self, element: Element, key: str, default: float | None = None) -> float:
        """A finite number; without default it must be there.

        Args:
            element: that has it. key: attribute. default: if absent.
        """
        if key in element.attributes:
            return self.value(element, key, element.get(key).strip())
        if default is None:
            self.add("number", element, f"{key} is missing", f'write {key}="…"')
        return default or 0.0

    def vector(self, element: Element, key: str, default: Vector | None) -> Vector:
        """Three finite numbers.

        Args:
            element: that has them. key: attribute. default: if absent.
        """
        if key not in element.attributes and default is not None:
            return default
        text = element.get(key)
        parts = text.split()
        if len(parts) != 3:
            reason = f"{key} has {len(parts)} numbers, 3 are expected"
            self.add("number", element, reason, _comma(text) or f'write {key}="x y z"', key)
            return _ZERO
        return tuple(self.value(element, key, part) for part in parts)

    def value(self, element: Element, key: str, text: str) -> float:
        """The finite number that a text stands for.

        Args:
            element: that has it. key: attribute, or the element's tag. text: to read.
        """
        value = float(text) if _DECIMAL.fullmatch(text) else math.nan
        if not math.isfinite(value):
            reason = f"{key} = {text[:40]!r} is not a finite number"
            cure = _comma(text) or "write a decimal number such as 0.25"
        elif abs(value) > _HUGE and element.tag != "limit":
            reason = f"{key} = {value:g} is beyond ±{_HUGE:g}"
            cure = "lengths are in m, masses in kg, angles in rad"
        else:
            return value
        self.add("number", element, reason, cure, key)
        return 0.0

    def pose(self, owner: Element) -> tuple[Vector, Vector]:
        """xyz (m) and rpy (rad) of the <origin> of an element."""
        origin = owner.find("origin")
        if origin is None:
            return _ZERO, _ZERO
        return self.vector(origin, "xyz", _ZERO), self.vector(origin, "rpy", _ZERO)


def _comma(text: str) -> str:
    if "${" in text:
        return "expand the macros first (xacro in.xacro > out.urdf)"
    return "decimals are written with a point, numbers parted by blanks" if "," in text else ""


def read_document(file: Path, data: bytes) -> Document:
    """Links and joints of a URDF text; `findings` of the result holds what is wrong with them.

    Raises:
        ModelError: the text is not the XML of a robot at all, or has more than 512 links.
    """
    root = parse(file, data)
    document = Document(file, root.get("name"), root)
    if not document.name:
        document.add("name", root, "the robot has no name", 'write <robot name="…">')
    _check_words(document, root)
    for element in root.findall("link"):
        inertial = element.find("inertial")
        read = None if inertial is None else _inertial(document, inertial)
        _keep(document, document.links, Link(element.get("name"), read, element))
    if not document.links:
        document.add("tree", root, "the robot has no link")
    for element in root.findall("joint"):
        _keep(document, document.joints, _joint(document, element))
    for element in root.findall("transmission"):
        _read_rotor(document, element)
    return document


def _check_words(document: Document, element: Element) -> None:
    """Note elements and attributes that are misspelt, or twice where one may stand."""
    known = _CHILDREN.get(element.tag, ())
    seen: dict[str, Element] = {}
    for child in element.children:
        tag = child.tag
        first = seen.setdefault(tag, child)
        if tag in _ONCE.get(element.tag, ()) and first is not child:
            reason = f"a second <{tag}>; the first is in line {first.line}"
            document.add("xml", child, reason, "delete one")
        misspelt = [] if tag in known else difflib.get_close_matches(tag.lower(), known, 1, 0.8)
        for near in misspelt:
            document.add("xml", child, f"<{tag}> is no word of URDF", f"did you mean <{near}>?")
        allowed = _ATTRIBUTES.get(tag) if element.tag in ("joint", "inertial") else None
        for key in child.attributes if allowed else ():
            if allowed and key not in allowed:
                cure = f"there is: {', '.join(allowed)}"
                document.add("xml", child, f"<{tag}> has no attribute {key!r}", cure)
        if tag in _CHILDREN or tag in _ONCE:
            _check_words(document, child)


def _read_rotor(document: Document, element: Element) -> None:
    """Rotor inertia and gear ratio of the joint of a transmission with one joint and one motor."""
    joints = element.findall("joint")
    if len(joints) != 1 or len(element.findall("actuator")) != 1:
        return
    inertia = 0.0
    ratio = 1.0
    for part in element.findall("joint", "actuator"):
        for child in part.findall("mechanicalReduction", "rotorInertia"):
            value = document.value(child, child.tag, child.text.strip())
            if child.tag == "mechanicalReduction":
                ratio = value
                continue
            inertia = value
            if inertia < 0.0:
                reason = f"rotor inertia {inertia:g} is negative"
                document.add("joint", child, reason, "write a value ≥ 0")
    document.rotors[joints[0].get("name")] = (inertia, ratio)


def _keep(document: Document, kept: dict[str, Part], one: Part) -> None:
    """Keep a link or a joint under its name, if that name is unique."""
    element = one.element
    name = one.name
    if name in kept and name.strip():
        reason = f"a second {element.tag} of that name; the first is in line "
        document.add("name", element, f"{reason}{kept[name].element.line}", "rename one")
        return
    kept[name] = one
    if not name.strip():
        document.add("name", element, f"a {element.tag} without a name", 'write name="…"')
    elif len(name) > MAX_NAME:
        reason = f"the name has {len(name)} characters"
        document.add("name", element, reason, f"use at most {MAX_NAME}")
    elif name == "universe":
        reason = "the name 'universe' means the world in Pinocchio"
        document.add("name", element, reason, "rename it")


def _inertial(document: Document, element: Element) -> Inertial:
    for word in ("mass", "inertia"):
        if element.find(word) is None:
            document.add("inertia", element, f"<inertial> without <{word}>", f"add <{word}>")
    mass = element.find("mass")
    tensor = element.find("inertia")
    return Inertial(
        0.0 if mass is None else document.number(mass, "value"),
        *document.pose(element),
        () if tensor is None else tuple(document.number(tensor, key) for key in MOMENTS),
        element,
    )


def _joint(document: Document, element: Element) -> Joint:
    kind = element.get("type")
    if kind in ("planar", "floating"):
        reason = f"a {kind} joint (nq ≠ nv) is not supported"
        cure = "build it from prismatic and revolute joints, or fix it"
        document.add("joint", element, reason, cure, "type")
    elif kind not in _KINDS:
        reason = "unknown joint type" if kind else "no joint type"
        document.add("joint", element, reason, suggest(kind, _KINDS), "type")
    for word in ("parent", "child"):
        if element.find(word) is None:
            cure = f'add <{word} link="…"/>'
            document.add("tree", element, f"a joint without <{word}>", cure)
    losses = {"damping": 0.0, "friction": 0.0}
    for dynamics in element.findall("dynamics"):
        for key in losses:
            losses[key] = value = document.number(dynamics, key, 0.0)
            if value < 0:
                reason = f"{key} {value:g} is negative: it would drive the joint"
                document.add("joint", dynamics, reason, "write a value ≥ 0", key)
    mimic = element.find("mimic")
    if mimic is not None:
        document.number(mimic, "multiplier", 1.0)
        document.number(mimic, "offset", 0.0)
    return Joint(
        element.get("name"),
        kind,
        element.part("parent").get("link"),
        element.part("child").get("link"),
        *document.pose(element),
        _axis(document, element, kind),
        {
            key: document.number(limit, key)
            for limit in element.findall("limit")
            for key in LIMITS
            if key in limit.attributes and kind != "fixed"
        },
        losses["damping"],
        losses["friction"],
        None if mimic is None else mimic.get("joint"),
        element,
    )


def _axis(document: Document, element: Element, kind: str) -> Vector:
    """Unit axis of a joint; (1, 0, 0) where none is given (URDF's default)."""
    axis = element.find("axis")
    default = (1.0, 0.0, 0.0)
    if axis is None or kind == "fixed":
        return default
    known = len(document.findings)
    numbers = document.vector(axis, "xyz", None)
    length = math.hypot(*numbers)
    if len(document.findings) == known and not abs(length - 1.0) <= 1e-4:
        reason = f"the axis has length {length:.6g}; readers disagree on what that means"
        document.add("joint", axis, reason, "write a unit vector", "xyz")
    return default if len(document.findings) > known else tuple(x / length for x in numbers)


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
                document.add("tree", end, reason, suggest(name, list(links)[:40]), "link")
        if joint.parent == joint.child:
            reason = f"joins the link {joint.child!r} to itself"
            document.add("tree", element, reason, "a joint needs two links")
        elif joint.child in above:
            reason = f"the link {joint.child!r} already hangs on joint {above[joint.child].name!r}"
            cure = "close loops as contacts or constraints, not in the URDF"
            document.add("tree", element, reason, cure)
        above[joint.child] = joint
    if document.findings:
        return
    roots = [name for name in links if name not in above]
    if len(roots) > 1:
        reason = f"{len(roots)} links have no parent: {', '.join(map(repr, roots[:5]))}; "
        cure = "join them or delete the loose ones"
        document.add("tree", links[roots[1]].element, f"{reason}a robot has one root", cure)
    _check_loops(document, above)


def _check_loops(document: Document, above: dict[str, Joint]) -> None:
    """Links whose way upwards never ends are on a loop or hang on one."""
    grounded: set[str] = set()
    for name in document.links:
        way: list[str] = []
        while name in above and name not in grounded and name not in way:
            way.append(name)
            name = above[name].parent
        if name in way:
            loop = " → ".join(map(repr, way[way.index(name) :][:5]))
            cure = "open it; close loops as constraints"
            document.add("tree", above[name].element, f"the links {loop} form a loop", cure)
            return
        grounded.update(way)


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
            document.add("joint", mimic, reason, suggest(joint.mimic, list(joints)[:40]), "joint")
            continue
        if master.kind == "fixed":
            reason = f"follows the fixed joint {joint.mimic!r}"
            document.add("joint", mimic, reason, "follow a joint that moves", "joint")
        seen: list[Joint] = []
        while master is not None and master not in seen:
            seen.append(master)
            master = joints.get(master.mimic or "")
        if joint in seen:
            document.add("joint", mimic, "follows itself", "follow another", "joint")
