"""A URDF as data: links and joints with their numbers, and what is wrong with them."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from osc_contact.robots.findings import ModelFinding, refuse
from osc_contact.robots.xml_tree import Element

__all__ = ["Document", "Inertial", "Joint", "Link", "Vector"]

Vector = tuple[float, ...]


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


@dataclass(slots=True, eq=False)
class Document:
    """A URDF whose words and numbers are sound; `findings` holds what is not.

    `rotors`: by joint, inertia of its motor's rotor (kg m²) and gear ratio, as transmissions say.
    """

    file: Path
    name: str
    root: Element
    links: dict[str, Link] = field(default_factory=dict)
    joints: dict[str, Joint] = field(default_factory=dict)
    rotors: dict[str, tuple[float, float]] = field(default_factory=dict)
    findings: list[ModelFinding] = field(default_factory=list)

    def add(self, check: str, element: Element, reason: str, cure: str = "", key: str = "") -> None:
        """Note what is wrong with an element (or with its attribute `key`).

        Args:
            check: that failed. element: at fault. reason, cure: sentences. key: attribute.
        """
        place = (self.file, element.line, element.column, element.label(key))
        self.findings.append(ModelFinding(check, *place, reason, cure))

    def require(self) -> None:
        """Raise what was found, if anything."""
        if self.findings:
            refuse(self.findings)
