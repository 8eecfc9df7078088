"""From XML to links and joints with numbers; every word and number is checked.

Words that look like a misspelt word of URDF are refused, because every reader would skip them in
silence. Extensions of simulators (gazebo, …) are passed over; of transmissions only rotor inertia
and gear ratio are read.
"""

from __future__ import annotations

from pathlib import Path
from typing import TypeVar

from osc_contact.robots.attributes import check_words, content, number, vector
from osc_contact.robots.document import Document, Inertial, Joint, Link, Vector
from osc_contact.robots.findings import suggest
from osc_contact.robots.xml_tree import Element, parse

__all__ = ["MAX_NAME", "read_document"]

MAX_NAME = 256
_KINDS = ("revolute", "continuous", "prismatic", "fixed")
_NO_NUMBERS = (0.0, 0.0, 0.0)
_MOMENTS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")

Part = TypeVar("Part", Link, Joint)


def read_document(file: Path, data: bytes) -> Document:
    """Links and joints of a URDF text; `findings` of the result tells what is wrong with them.

    Raises:
        ModelError: the text is not the XML of a robot at all, or has more than 512 links.
    """
    root = parse(file, data)
    document = Document(file, root.get("name") or "", root)
    if not document.name:
        document.add("name", root, "the robot has no name", 'write <robot name="…">')
    check_words(document, root)
    links, joints = root.findall("link"), root.findall("joint")
    if not links:
        document.add("tree", root, "the robot has no link")
    for element in links:
        _keep(document, document.links, _link(document, element))
    for element in joints:
        _keep(document, document.joints, _joint(document, element))
    for element in root.findall("transmission"):
        _read_rotor(document, element)
    return document


def _read_rotor(document: Document, element: Element) -> None:
    """Rotor inertia and gear ratio of the joint of a transmission with one joint and one motor."""
    joints, motors = element.findall("joint"), element.findall("actuator")
    if len(joints) != 1 or len(motors) != 1:
        return
    inertia, ratio = 0.0, 1.0
    for part in (*joints, *motors):
        for child in part.children:
            if child.tag == "mechanicalReduction":
                ratio = content(document, child)
            elif child.tag == "rotorInertia":
                inertia = content(document, child)
                if inertia < 0.0:
                    document.add("joint", child, f"rotor inertia {inertia:g} is negative",
                                 "write a value ≥ 0")  # fmt: skip
    document.rotors[joints[0].get("name") or ""] = (inertia, ratio)


def _keep(document: Document, kept: dict[str, Part], one: Part) -> None:
    tag, name = one.element.tag, one.name
    if not name.strip():
        document.add("name", one.element, f"a {tag} without a name", 'write name="…"')
    elif len(name) > MAX_NAME:
        document.add("name", one.element, f"the name has {len(name)} characters",
                     f"use at most {MAX_NAME}")  # fmt: skip
    elif name == "universe":
        document.add("name", one.element, "the name 'universe' means the world in Pinocchio",
                     "rename it")  # fmt: skip
    elif name in kept:
        document.add("name", one.element, f"a second {tag} of that name; the first is in line "
                     f"{kept[name].element.line}", "rename one")  # fmt: skip
        return
    kept[name] = one


def _link(document: Document, element: Element) -> Link:
    inertial = element.find("inertial")
    return Link(
        element.get("name") or "",
        None if inertial is None else _inertial(document, inertial),
        element,
    )


def _inertial(document: Document, element: Element) -> Inertial:
    xyz, rpy = _origin(document, element)
    mass, tensor = element.find("mass"), element.find("inertia")
    for word, child in (("mass", mass), ("inertia", tensor)):
        if child is None:
            document.add("inertia", element, f"<inertial> without <{word}>", f"add <{word}>")
    return Inertial(
        0.0 if mass is None else number(document, mass, "value"),
        xyz,
        rpy,
        (0.0,) * 6 if tensor is None else tuple(number(document, tensor, k) for k in _MOMENTS),
        element,
    )


def _joint(document: Document, element: Element) -> Joint:
    kind = element.get("type") or ""
    if kind in ("planar", "floating"):
        document.add("joint", element, f"a {kind} joint (nq ≠ nv) is not supported",
                     "build it from prismatic and revolute joints, or fix it", "type")  # fmt: skip
    elif kind not in _KINDS:
        document.add("joint", element, "unknown joint type" if kind else "no joint type",
                     suggest(kind, _KINDS), "type")  # fmt: skip
    ends = {}
    for word in ("parent", "child"):
        child = element.find(word)
        if child is None:
            document.add("tree", element, f"a joint without <{word}>", f'add <{word} link="…"/>')
        ends[word] = "" if child is None else child.get("link") or ""
    xyz, rpy = _origin(document, element)
    limit, dynamics, mimic = (element.find(word) for word in ("limit", "dynamics", "mimic"))
    limits: dict[str, float] = {} if limit is None else {
        key: number(document, limit, key)
        for key in ("lower", "upper", "effort", "velocity")
        if key in limit.attributes and kind != "fixed"
    }  # fmt: skip
    damping, friction = (
        0.0 if dynamics is None else number(document, dynamics, key, 0.0)
        for key in ("damping", "friction")
    )
    for key, value in (("damping", damping), ("friction", friction)):
        if dynamics is not None and value < 0:
            document.add("joint", dynamics, f"{key} {value:g} is negative: it would drive the "
                         "joint", "write a value ≥ 0", key)  # fmt: skip
    if mimic is not None:
        for key, default in (("multiplier", 1.0), ("offset", 0.0)):
            number(document, mimic, key, default)
    return Joint(
        element.get("name") or "", kind, ends["parent"], ends["child"], xyz, rpy,
        _axis(document, element, kind), limits, damping, friction,
        None if mimic is None else mimic.get("joint") or "", element,
    )  # fmt: skip


def _origin(document: Document, element: Element) -> tuple[Vector, Vector]:
    origin = element.find("origin")
    if origin is None:
        return _NO_NUMBERS, _NO_NUMBERS
    return tuple(vector(document, origin, key, _NO_NUMBERS) for key in ("xyz", "rpy"))  # type: ignore[return-value]


def _axis(document: Document, element: Element, kind: str) -> Vector:
    """Unit axis of a joint; (1, 0, 0) where none is given, as the URDF specification says."""
    axis = element.find("axis")
    if axis is None or kind == "fixed":
        return (1.0, 0.0, 0.0)
    known = len(document.findings)
    x, y, z = vector(document, axis, "xyz", None)
    if len(document.findings) > known:
        return (1.0, 0.0, 0.0)
    length = (x * x + y * y + z * z) ** 0.5
    if not abs(length - 1.0) <= 1e-4:
        document.add("joint", axis, f"the axis has length {length:.6g}; readers disagree on what "
                     "that means", "write a unit vector", "xyz")  # fmt: skip
        return (1.0, 0.0, 0.0)
    return x / length, y / length, z / length
