"""Bodies of the environment: how they move, what the controller knows of it, their geometry."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from osc_contact.contacts.detection import CollisionShape, TrackedContact, collision_shapes
from osc_contact.contacts.pairs import ContactPair
from osc_contact.dynamics.rail import Body, Cart, Conveyor, Hinge
from osc_contact.errors import ScenarioError
from osc_contact.plants.faces import Rail
from osc_contact.runs.contacts import EnvironmentBody
from osc_contact.scenarios.contact_schema import CartSpec, ConveyorSpec, FaceMotion, HingeSpec
from osc_contact.scenarios.signals import total
from osc_contact.spatial import Array

__all__ = ["OwnMotion", "known_bodies", "rails", "tracked"]


@dataclass(frozen=True)
class OwnMotion:
    """How a body of the environment moves, given as objects: `motion` in a scenario made in Python.

    Attributes:
        rail: how the plants move it; driven by any function of time, or free.
        body: how it answers forces, as far as the controller knows; None: like a face at rest.
    """

    rail: Rail
    body: Body | None = None


def rails(bodies: Sequence[EnvironmentBody]) -> list[Rail | None]:
    """How each body of the plant moves; None: not at all.

    Raises:
        ScenarioError: a driven body does not start where the contacts touch.
    """
    return [None if body.motion is None else _rail(body.name, body.motion) for body in bodies]


def _rail(name: str, motion: FaceMotion | OwnMotion) -> Rail:
    rail = motion.rail if isinstance(motion, OwnMotion) else _described(motion)
    if rail.motion is not None:
        (travel, angle), (speed, rate), _ = rail.motion(0.0)
        if max(map(abs, (travel, angle, speed, rate))) > 1e-9:
            raise ScenarioError(
                f"the motion of '{name}' starts at {travel:g} m with {speed:g} m/s and "
                f"{angle:g} rad with {rate:g} rad/s, away from where the contacts touch; give "
                "sines a ramp, or use minimum_jerk"
            )
    return rail


def _described(motion: FaceMotion) -> Rail:
    if isinstance(motion, CartSpec):
        return Rail(np.array(motion.direction), inertia=motion.mass, **_freely(motion))
    if isinstance(motion, HingeSpec):
        axis, through = np.array(motion.axis), np.array(motion.through)
        return Rail(axis=axis, through=through, inertia=motion.inertia, **_freely(motion))
    turn = motion.turn
    still = np.zeros(3)
    axis, through = (still, still) if turn is None else map(np.array, (turn.axis, turn.through))
    return Rail(np.array(motion.direction), axis, through, partial(_commanded, motion))


def _commanded(motion: ConveyorSpec, t: float) -> tuple[Array, Array, Array]:
    """(s, ṡ, s̈) of travel (m) and angle (rad), each (2,)."""
    turn = () if motion.turn is None else motion.turn.signals
    s, rates, second = np.array([total(motion.signals, t), total(turn, t)]).T
    return s, rates, second


def _freely(motion: CartSpec | HingeSpec) -> dict[str, Any]:
    return {key: getattr(motion, key) for key in ("stiffness", "damping", "preload")}


def known_bodies(
    bodies: Sequence[EnvironmentBody], contacts: int, ignored: bool
) -> list[Body | None]:
    """How the body at each contact answers, as far as the controller knows.

    Args:
        bodies: of the environment. contacts: how many. ignored: the controller knows of none.
    """
    known: list[Body | None] = [None] * contacts
    for body in () if ignored else bodies:
        motion = body.motion
        answer: Body | None = None
        if isinstance(motion, OwnMotion):
            answer = motion.body
        elif isinstance(motion, CartSpec):
            answer = Cart(np.array(motion.direction), motion.mass, **_freely(motion))
        elif isinstance(motion, HingeSpec):
            axis, through = np.array(motion.axis), np.array(motion.through)
            answer = Hinge(axis, through, motion.inertia, **_freely(motion))
        elif motion is not None:
            answer = Conveyor()
        for i in body.contacts:
            known[i] = answer
    return known


def tracked(
    pairs: Sequence[ContactPair], object_urdf: Path, bodies: Sequence[EnvironmentBody]
) -> tuple[TrackedContact, ...]:
    """Contacts read off the collision geometry; of the declared ones only the names are used.

    Args:
        pairs: declared contacts. object_urdf: file of the object. bodies: of the environment.

    Raises:
        ScenarioError: several contacts are on one body: they could not be distinguished.
    """
    held = collision_shapes(object_urdf)
    found = {}
    for body in bodies:
        if len(body.contacts) > 1:
            names = ", ".join(pairs[i].name for i in body.contacts)
            raise ScenarioError(
                f"control.contacts: detected finds all that touches '{body.name}' as one contact, "
                f"but {names} are on it; declare one contact for each body, or use declared"
            )
        shapes = collision_shapes(body.urdf[0])
        face = [CollisionShape(s.name, s.shape, body.placement * s.placement) for s in shapes]
        for i in body.contacts:
            found[i] = TrackedContact(held, face, pairs[i].name)
    return tuple(found[i] for i in range(len(pairs)))
