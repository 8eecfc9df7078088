"""Bodies of the environment: how they slide, what the controller knows of it, their geometry."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np

from osc_contact.contacts.detection import CollisionShape, TrackedContact, collision_shapes
from osc_contact.contacts.pairs import ContactPair
from osc_contact.dynamics.rail import Body, Cart, Conveyor
from osc_contact.errors import ScenarioError
from osc_contact.experiments.contacts import EnvironmentBody
from osc_contact.plants.faces import Rail
from osc_contact.scenarios.signals import total
from osc_contact.scenarios.touching import CartSpec

__all__ = ["known_bodies", "rails", "tracked"]


def rails(bodies: Sequence[EnvironmentBody]) -> list[Rail | None]:
    """How each body of the plant slides; None: fixed.

    Raises:
        ScenarioError: a conveyor does not start where the contacts touch.
    """
    found: list[Rail | None] = []
    for body in bodies:
        motion = body.motion
        if motion is None:
            found.append(None)
        elif isinstance(motion, CartSpec):
            found.append(Rail(np.array(motion.direction), None, motion.mass, motion.stiffness,
                              motion.damping, motion.preload))  # fmt: skip
        else:
            signals = motion.signals
            travel, speed, _ = total(signals, 0.0)
            if abs(travel) > 1e-9 or abs(speed) > 1e-9:
                raise ScenarioError(
                    f"the motion of '{body.name}' starts at {travel:g} m with {speed:g} m/s, away "
                    "from where the contacts touch; give sines a ramp, or use minimum_jerk"
                )
            found.append(Rail(np.array(motion.direction), partial(total, signals)))
    return found


def known_bodies(
    bodies: Sequence[EnvironmentBody], contacts: int, ignored: bool
) -> list[Body | None]:
    """How the body at each contact answers, as far as the controller knows."""
    found: list[Body | None] = [None] * contacts
    for body in () if ignored else bodies:
        motion = body.motion
        answer: Body | None = None
        if isinstance(motion, CartSpec):
            answer = Cart(np.array(motion.direction), motion.mass, motion.stiffness,
                          motion.damping, motion.preload)  # fmt: skip
        elif motion is not None:
            answer = Conveyor()
        for i in body.contacts:
            found[i] = answer
    return found


def tracked(
    pairs: Sequence[ContactPair], object_urdf: Path, bodies: Sequence[EnvironmentBody]
) -> tuple[TrackedContact, ...]:
    """Contacts read off the collision geometry; of the declared ones only the names are used.

    Raises:
        ScenarioError: several contacts are on one body: they could not be told apart.
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
