"""Links and joints of a URDF with numbers; every word and number is checked.

Words that look like a misspelt word of URDF are refused, because other readers skip them silently.
Extensions of simulators (gazebo, …) are ignored; of transmissions only rotor inertia and gear ratio
are read. The text is read by `robots.elements`.
"""

from __future__ import annotations

import difflib
import math
from dataclasses import dataclass, field
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import NamedTuple, TypeVar

from osc_contact.errors import did_you_mean
from osc_contact.robots.elements import Element, Vector, parse, refuse

# Words of URDF: attributes, children of each element, children that may occur once.

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


class Inertial(NamedTuple):
    """Inertia of a link as written.

    Attributes:
        mass: mass (kg).
        origin: "xyz" (m) and "rpy" (rad) of the frame at the centre of mass.
        moments: moments of inertia "ixx" … "izz" in that frame (kg m²); empty if missing.
        element: the <inertial>.
    """

    mass: float
    origin: dict[str, Vector]
    moments: dict[str, float]
    element: Element


class Link(NamedTuple):
    """Link as written.

    Attributes:
        name: name of the link.
        inertial: inertia, or None.
        element: the <link>.
    """

    name: str
    inertial: Inertial | None
    element: Element


class Joint(NamedTuple):
    """Joint as written.

    Attributes:
        name, kind: name and type.
        parent, child: names of the links.
        origin: "xyz" (m) and "rpy" (rad) of its frame in the parent.
        axis: unit vector in its frame.
        limits: numbers of its <limit> by attribute (rad, N m, rad/s; m, N, m/s).
        losses: "damping" (N m s/rad, N s/m) and "friction" (N m, N).
        mimic: name of its master; None without one.
        element: the <joint>.
    """

    name: str
    kind: str
    parent: str
    child: str
    origin: dict[str, Vector]
    axis: Vector
    limits: dict[str, float]
    losses: dict[str, float]
    mimic: str | None
    element: Element


Part = TypeVar("Part", Link, Joint)


@dataclass(slots=True, eq=False)
class Document:
    """Content of a URDF.

    Attributes:
        file: the file.
        name: name of the robot.
        root: root element, whose `findings` are the errors of the file.
        links, joints: links and joints by name.
        rotors: inertia of the motor's rotor (kg m²) and gear ratio by the name of the joint, from
            transmissions.
    """

    file: Path
    name: str
    root: Element
    links: dict[str, Link] = field(default_factory=dict)
    joints: dict[str, Joint] = field(default_factory=dict)
    rotors: dict[str, tuple[float, float]] = field(default_factory=dict)

    def require(self) -> None:
        """Raise the findings, if there are any.

        Raises:
            ModelError: there are findings.
        """
        if self.root.findings:
            refuse(self.root.findings)


def read_document(file: Path, data: bytes) -> Document:
    """Read links and joints from the text of a URDF; errors of elements are noted as findings.

    Args:
        file: name of the file, for messages.
        data: its content.

    Raises:
        ModelError: the text is not the XML of a robot, see `parse`.
    """
    root = parse(file, data)
    document = Document(file, root.get("name"), root)
    if not document.name:
        root.note("name", "the robot has no name", 'write <robot name="…">')
    _check_words(root)
    for element in root.findall("link"):
        inertial = element.find("inertial")
        inertia = None if inertial is None else _read_inertial(inertial)
        _add_element(document.links, Link(element.get("name"), inertia, element))
    if not document.links:
        root.note("tree", "the robot has no link")
    for element in root.findall("joint"):
        _add_element(document.joints, _read_joint(element))
    for element in root.findall("transmission"):
        joints = element.findall("joint")
        if len(joints) == len(element.findall("actuator")) == 1:
            document.rotors[joints[0].get("name")] = _read_rotor(element)
    return document


def _check_words(element: Element) -> None:
    """Note misspelt elements and attributes, and second elements that may occur only once.

    Args:
        element: element whose children are checked, and those of known children.
    """
    tags = _CHILDREN.get(element.tag, ())
    first_children: dict[str, Element] = {}  # first child with each tag
    for child in element.children:
        tag = child.tag
        first = first_children.setdefault(tag, child)
        if tag in _ONCE.get(element.tag, ()) and first is not child:
            child.note("xml", f"a second <{tag}>; the first is in line {first.line}", "delete one")
        if tag not in tags and (similar := difflib.get_close_matches(tag.lower(), tags, 1, 0.8)):
            child.note("xml", f"<{tag}> is no word of URDF", f"did you mean <{similar[0]}>?")
        if element.tag in ("joint", "inertial") and (allowed := _ATTRIBUTES.get(tag)):
            cure = f"there is: {', '.join(allowed)}"
            for key in child.attributes:
                if key not in allowed:
                    child.note("xml", f"<{tag}> has no attribute {key!r}", cure)
        if tag in _CHILDREN or tag in _ONCE:
            _check_words(child)


def _read_rotor(transmission: Element) -> tuple[float, float]:
    """Read rotor inertia (kg m²) and gear ratio of a transmission with one joint and one motor.

    Without them the inertia is 0 and the ratio 1; errors are noted.
    """
    values = {"rotorInertia": 0.0, "mechanicalReduction": 1.0}
    for part in transmission.findall("joint", "actuator"):
        for child in part.findall(*values):
            value = child.value(child.tag, child.text.strip())
            values[child.tag] = value
            if child.tag == "rotorInertia" and value < 0.0:
                child.note("joint", f"rotor inertia {value:g} is negative", "write a value ≥ 0")
    return (values["rotorInertia"], values["mechanicalReduction"])


def _add_element(parts: dict[str, Part], part: Part) -> None:
    """Add a link or joint to those of the document; note a name that is not unique or not usable.

    Args:
        parts: links, or joints, by name.
        part: link or joint to be added.
    """
    element = part.element
    name = part.name
    if name in parts and name.strip():
        first = parts[name].element.line
        reason = f"a second {element.tag} of that name; the first is in line {first}"
        element.note("name", reason, "rename one")
        return
    parts[name] = part
    if not name.strip():
        element.note("name", f"a {element.tag} without a name", 'write name="…"')
    elif len(name) > MAX_NAME:
        element.note("name", f"the name has {len(name)} characters", f"use at most {MAX_NAME}")
    elif name == "universe":
        element.note("name", "the name 'universe' means the world in Pinocchio", "rename it")


def _read_inertial(element: Element) -> Inertial:
    """Read an <inertial>; errors are noted as findings, and numbers that are missing are 0.

    Args:
        element: element of the URDF, to which findings are added.
    """
    for word in ("mass", "inertia"):
        if element.find(word) is None:
            element.note("inertia", f"<inertial> without <{word}>", f"add <{word}>")
    mass = element.find("mass")
    tensor = element.find("inertia")
    return Inertial(
        mass=0.0 if mass is None else mass.number("value"),
        origin=element.origin(),
        moments={} if tensor is None else {key: tensor.number(key) for key in MOMENTS},
        element=element,
    )


def _read_joint(element: Element) -> Joint:
    """Read a <joint>; errors are noted as findings, and the joint is read as far as possible.

    Args:
        element: element of the URDF, to which findings are added.
    """
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
    losses = _read_losses(element)
    mimic = element.find("mimic")
    if mimic is not None:  # read for its findings only: a joint that follows is locked or refused
        mimic.number("multiplier", 1.0)
        mimic.number("offset", 0.0)
    return Joint(
        name=element.get("name"),
        kind=kind,
        parent=element.part("parent").get("link"),
        child=element.part("child").get("link"),
        origin=element.origin(),
        axis=_read_axis(element, kind),
        limits={} if kind == "fixed" else _read_limits(element),
        losses=losses,
        mimic=None if mimic is None else mimic.get("joint"),
        element=element,
    )


def _read_losses(element: Element) -> dict[str, float]:
    """Read damping (N m s/rad, N s/m) and friction (N m, N) of a <joint>; negative ones are noted.

    Both are 0 without <dynamics>.

    Args:
        element: element of the URDF, to which findings are added.
    """
    losses = {"damping": 0.0, "friction": 0.0}
    for dynamics in element.findall("dynamics"):
        for key in losses:
            losses[key] = dynamics.number(key, 0.0)
            if losses[key] < 0:
                reason = f"{key} {losses[key]:g} is negative: it would drive the joint"
                dynamics.note("joint", reason, "write a value ≥ 0", key)
    return losses


def _read_limits(element: Element) -> dict[str, float]:
    """Read the numbers that the <limit> of a <joint> has (rad, N m, rad/s; m, N, m/s).

    Args:
        element: element of the URDF, to which findings are added.
    """
    limits = {}
    for limit in element.findall("limit"):
        for key in LIMITS:
            if key in limit.attributes:
                limits[key] = limit.number(key)
    return limits


def _read_axis(element: Element, kind: str) -> Vector:
    """Read the unit axis of a <joint>; an axis of another length is noted and normalised.

    Without <axis> it is (1, 0, 0), as URDF defines.

    Args:
        element: the <joint>.
        kind: type of the joint; a fixed joint has no axis.
    """
    axis = element.find("axis")
    if axis is None or kind == "fixed":
        return (1.0, 0.0, 0.0)
    count = len(axis.findings)
    numbers = axis.vector("xyz")
    length = math.hypot(*numbers)
    if len(axis.findings) == count and not abs(length - 1.0) <= 1e-4:
        reason = f"the axis has length {length:.6g}; readers disagree on what that means"
        axis.note("joint", reason, "write a unit vector", "xyz")
    if length == 0.0:
        return numbers
    return tuple(x / length for x in numbers)


# Links and joints form one tree -------------------------------------------------------------------


def check_tree(document: Document) -> None:
    """Note joints' links that do not exist, links with two parents, several roots, and loops.

    Args:
        document: document of the URDF, to whose findings errors are added.
    """
    links = document.links
    above: dict[str, Joint] = {}  # joint above each link
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
    """Note mimic joints whose master does not exist, is fixed, or depends on the joint itself.

    Args:
        document: document of the URDF, to whose findings errors are added.
    """
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
        masters: list[Joint] = []  # master, master of the master, …
        while master is not None and master not in masters:
            masters.append(master)
            master = joints.get(master.mimic or "")
        if joint in masters:
            mimic.note("joint", "follows itself", "follow another", "joint")
