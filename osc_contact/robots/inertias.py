"""Inertias: those a body can have, or at least those that leave every motion some energy."""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np
import pinocchio as pin

from osc_contact.errors import InvalidInputError
from osc_contact.robots.document import Document, Inertial, Link
from osc_contact.spatial import Array

__all__ = ["Inertias", "check_inertias", "check_moving_bodies", "require_level"]

Inertias = Literal["possible", "positive"]
"""What is asked of inertias.

"possible": every link is a body: mass ≥ 0, principal moments ≥ 0, none larger than the sum of the
others. "positive": only the rigid bodies that move (links joined by fixed joints taken together)
are looked at, and only their kinetic energy must not be negative. Then the mass matrix still is
positive definite, but no distribution of mass need have those moments.
"""

_SLACK, _DUST = 1e-6, 1e-12
"""Relative slack: of the link's own moments (digits a URDF carries), of the robot's largest."""


def require_level(inertias: str) -> None:
    """Refuse a level that does not exist."""
    if inertias not in get_args(Inertias):
        raise InvalidInputError(f"inertias={inertias!r}; there is: {', '.join(get_args(Inertias))}")


def check_inertias(document: Document, inertias: Inertias) -> None:
    """Note negative masses, and, for "possible", links whose inertia no body has."""
    links = [link for link in document.links.values() if link.inertial is not None]
    for link in links:
        inertial = link.inertial
        if inertial is not None and inertial.mass < 0:
            document.add("inertia", inertial.element.find("mass") or inertial.element,
                         f"mass {inertial.mass:g} kg is negative", "weigh the link",
                         "value")  # fmt: skip
    if inertias == "positive" or not links:
        return
    tensors = np.array([_tensor(link.inertial) for link in links if link.inertial is not None])
    moments = np.linalg.eigvalsh(tensors)
    dust = _DUST * np.abs(moments).max()
    for link, values in zip(links, moments, strict=True):
        _check_link(document, link, values, dust)


def check_moving_bodies(document: Document, model: pin.Model) -> None:
    """Note moving bodies whose kinetic energy can be negative."""
    bodies = list(model.inertias)[1:]
    if not bodies:
        return
    all_moments = np.linalg.eigvalsh(np.array([body.inertia for body in bodies]))
    dust = _DUST * np.abs(all_moments).max()
    for name, body, moments in zip(list(model.names)[1:], bodies, all_moments, strict=True):
        if body.mass < 0 or moments[0] < -_SLACK * np.abs(moments).max() - dust:
            document.add("inertia", document.joints[name].element,
                         f"the body that it moves has mass {body.mass:g} kg and principal "
                         f"moments {_listed(moments)} kg m²: its energy can be negative",
                         "correct the <inertial> of its links")  # fmt: skip


def _check_link(document: Document, link: Link, moments: Array, dust: float) -> None:
    inertial = link.inertial
    if inertial is None or inertial.mass < 0:
        return
    slack = _SLACK * np.abs(moments).max() + dust
    tensor = inertial.element.find("inertia") or inertial.element
    listed = f"principal moments {_listed(moments)} kg m²"
    relax = 'or load with inertias="positive" if the other links make up for it'
    if inertial.mass == 0 and np.abs(moments).max() > dust:
        document.add("inertia", tensor, f"mass 0 kg with {listed}", f"give it a mass, {relax}")
    elif moments[0] < -slack:
        document.add("inertia", tensor, f"the inertia is not positive: {listed}",
                     f"check the signs of ixy, ixz, iyz, {relax}")  # fmt: skip
    elif moments[0] + moments[1] < moments[2] - slack:
        document.add("inertia", tensor, f"no body has the {listed}: the largest exceeds the sum "
                     f"of the others by {moments[2] - moments[0] - moments[1]:.3g}",
                     f"check the units (kg m², about the centre of mass), {relax}")  # fmt: skip


def _tensor(inertial: Inertial) -> list[list[float]]:
    xx, xy, xz, yy, yz, zz = inertial.moments
    return [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]


def _listed(moments: Array) -> str:
    return ", ".join(f"{moment:.4g}" for moment in moments)
