"""The faces of a scenario: how they slide, what the controller knows of it, their geometry."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np

from osc_contact.contacts.detection import CollisionShape, TrackedContact, collision_shapes
from osc_contact.contacts.pairs import VertexOnFace
from osc_contact.dynamics.rail import Body, Cart, Conveyor
from osc_contact.errors import ScenarioError
from osc_contact.plants.faces import Rail
from osc_contact.scenarios.geometry import CartSpec
from osc_contact.scenarios.schema import Scenario
from osc_contact.scenarios.signals import total

__all__ = ["bodies", "rails", "tracked"]


def rails(scenario: Scenario) -> list[Rail | None]:
    """How each face of the plant slides; None: fixed.

    Raises:
        ScenarioError: a conveyor does not start where the contacts touch.
    """
    found: list[Rail | None] = []
    for contact in scenario.contacts:
        motion = contact.face.motion
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
                    f"contacts.{contact.name}.face.motion starts at {travel:g} m with {speed:g} "
                    "m/s, away from where the contacts touch; give sines a ramp, or use "
                    "minimum_jerk"
                )
            found.append(Rail(np.array(motion.direction), partial(total, signals)))
    return found


def bodies(scenario: Scenario) -> list[Body | None]:
    """How each face answers, as far as the controller knows."""
    found: list[Body | None] = []
    for contact in scenario.contacts:
        motion = contact.face.motion
        if motion is None or scenario.model_error.environment == "ignored":
            found.append(None)
        elif isinstance(motion, CartSpec):
            found.append(Cart(np.array(motion.direction), motion.mass, motion.stiffness,
                              motion.damping, motion.preload))  # fmt: skip
        else:
            found.append(Conveyor())
    return found


def tracked(
    pairs: Sequence[VertexOnFace], object_urdf: Path, face_urdfs: Sequence[Path]
) -> tuple[TrackedContact, ...]:
    """Contacts read off the collision geometry; of the declared ones only names and places of the
    faces are used."""
    held = collision_shapes(object_urdf)
    found = []
    for pair, urdf in zip(pairs, face_urdfs, strict=True):
        X = pair.face_placement()
        face = [CollisionShape(s.name, s.shape, X * s.placement) for s in collision_shapes(urdf)]
        found.append(TrackedContact(held, face, pair.name))
    return tuple(found)
