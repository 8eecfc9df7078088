"""Words and numbers of a URDF: misspelt ones and silent defaults are findings."""

from __future__ import annotations

import difflib
import math
import re

from osc_contact.robots.document import Document
from osc_contact.robots.xml_tree import Element

__all__ = ["check_words", "content", "number", "vector"]

_HUGE = 1e9
"""No length, mass, moment or angle of a robot is larger, in any unit anybody uses."""
_DECIMAL = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?", re.ASCII)

_CHILDREN = {
    "robot": ("link", "joint", "material", "transmission", "gazebo"),
    "link": ("inertial", "visual", "collision"),
    "joint": ("parent", "child", "origin", "axis", "limit", "dynamics", "mimic",
              "safety_controller", "calibration"),
    "inertial": ("origin", "mass", "inertia"),
}  # fmt: skip
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
    "inertia": ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"),
    "mimic": ("joint", "multiplier", "offset"),
}


def check_words(document: Document, root: Element) -> None:
    """Note elements and attributes that are misspelt, or twice where one may stand."""
    pending = [root]
    while pending:
        element = pending.pop()
        known, single = _CHILDREN.get(element.tag, ()), _ONCE.get(element.tag, ())
        seen: dict[str, Element] = {}
        for child in element.children:
            if child.tag in single and child.tag in seen:
                document.add("xml", child, f"a second <{child.tag}>; the first is in line "
                             f"{seen[child.tag].line}", "delete one")  # fmt: skip
            seen.setdefault(child.tag, child)
            if known and child.tag not in known:
                near = difflib.get_close_matches(child.tag.lower(), known, 1, 0.8)
                if near:
                    document.add("xml", child, f"<{child.tag}> is no word of URDF",
                                 f"did you mean <{near[0]}>?")  # fmt: skip
            if child.tag in _CHILDREN or child.tag in _ONCE:
                pending.append(child)
        if element.tag not in ("joint", "inertial"):
            continue
        for child in element.children:
            allowed = _ATTRIBUTES.get(child.tag)
            for key in child.attributes if allowed else ():
                if allowed and key not in allowed:
                    document.add("xml", child, f"<{child.tag}> has no attribute {key!r}",
                                 f"there is: {', '.join(allowed)}")  # fmt: skip


def number(document: Document, element: Element, key: str, default: float | None = None) -> float:
    """A finite number; without default it must be there.

    Args:
        document: collects complaints. element: that has it. key: attribute. default: if absent.
    """
    text = element.get(key)
    if text is None and default is not None:
        return default
    if text is None:
        document.add("number", element, f"{key} is missing", f'write {key}="…"')
        return 0.0
    return _value(document, element, key, text.strip())


def content(document: Document, element: Element) -> float:
    """The finite number that an element holds between its tags."""
    return _value(document, element, element.tag, element.text.strip())


def vector(
    document: Document, element: Element, key: str, default: tuple[float, ...] | None
) -> tuple[float, ...]:
    """Three finite numbers.

    Args:
        document: collects complaints. element: that has it. key: attribute. default: if absent.
    """
    text = element.get(key)
    if text is None and default is not None:
        return default
    parts = (text or "").split()
    if len(parts) != 3:
        document.add("number", element, f"{key} has {len(parts)} numbers, 3 are wanted",
                     _comma(text or "") or f'write {key}="x y z"', key)  # fmt: skip
        return (0.0, 0.0, 0.0)
    return tuple(_value(document, element, key, part) for part in parts)


def _value(document: Document, element: Element, key: str, text: str) -> float:
    value = float(text) if _DECIMAL.fullmatch(text) else math.nan
    if not math.isfinite(value):
        document.add("number", element, f"{key} = {text[:40]!r} is not a finite number",
                     _comma(text) or "write a decimal number such as 0.25", key)  # fmt: skip
        return 0.0
    if abs(value) > _HUGE and element.tag != "limit":
        document.add("number", element, f"{key} = {value:g} is beyond ±{_HUGE:g}",
                     "lengths are in m, masses in kg, angles in rad", key)  # fmt: skip
        return 0.0
    return value


def _comma(text: str) -> str:
    if "${" in text:
        return "expand the macros first (xacro in.xacro > out.urdf)"
    return "decimals are written with a point, numbers parted by blanks" if "," in text else ""
