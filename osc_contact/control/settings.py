"""What a controller is made of: taken once, never changed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from osc_contact.contacts.pairs import ContactPair
from osc_contact.control.friction import require_known_points
from osc_contact.control.reading import Reading, choose_reading
from osc_contact.dynamics.assembly import require_in_range
from osc_contact.dynamics.closed_chain import ClosedChain
from osc_contact.dynamics.rail import Body
from osc_contact.errors import InvalidInputError, ModelError
from osc_contact.scenarios.control_schema import (
    Friction,
    Gains,
    PhaseSettings,
    PostureTask,
    SafetySettings,
)
from osc_contact.spatial import Array, as_array

__all__ = ["Settings"]

#: Of a joint's range; how far beyond its limits `posture` may lie. It is a goal that the push away
#: from the limits keeps the joint from reaching, so a goal just outside does no harm; one that is
#: further out than this is given in other units (degrees, mm).
GOAL_BEYOND = 1.5


@dataclass(frozen=True, eq=False)
class Settings:
    """Everything a controller is given; see `Controller`. `reading` None becomes what it chooses.

    Raises:
        InvalidInputError: dt not positive, unknown metric, a posture far outside the joints'
            limits, or an arm without a wrist sensor
            although there are contacts: their forces could not be measured.
        ModelError: a redundant arm with passive joints.
    """

    chain: ClosedChain
    contacts: Sequence[ContactPair]
    gains: Gains = field(default_factory=Gains)
    dt: float = 1e-3
    B: Array | str = "object"
    bodies: Sequence[Body | None] = ()
    posture: Array = field(default_factory=lambda: np.zeros(0))
    posture_task: PostureTask = field(default_factory=PostureTask)
    friction: Friction | None = None
    phases: PhaseSettings | None = None
    safety: SafetySettings = field(default_factory=SafetySettings)
    joint_friction: bool = True
    reading: Reading | None = None

    def __post_init__(self) -> None:
        chain = self.chain
        if not (np.isfinite(self.dt) and self.dt > 0.0):
            raise InvalidInputError(f"dt = {self.dt}; give the control period in seconds, > 0")
        if isinstance(self.B, str):
            if self.B not in ("object", "chain"):
                raise InvalidInputError(
                    f"B = '{self.B}'; give 'object', 'chain' or a (6, 6) matrix"
                )
        else:
            object.__setattr__(self, "B", _definite(as_array("B", self.B, (6, 6))))
        blind = [arm.name for arm in chain.arms if arm.wrist_sensor is None]
        if self.contacts and blind:
            raise InvalidInputError(
                "contact forces are measured in the wrists of all arms together, but "
                f"{blind} have no wrist_sensor; name its frame when loading the arm"
            )
        object.__setattr__(self, "contacts", tuple(self.contacts))
        bodies = tuple(self.bodies) or (None,) * len(self.contacts)
        if len(bodies) != len(self.contacts):
            raise InvalidInputError(
                f"{len(self.contacts)} contacts but {len(bodies)} bodies; give one for each contact"
            )
        object.__setattr__(self, "bodies", bodies)
        if len(self.posture):
            posture = as_array("posture", self.posture, (chain.nq,))
            lower = np.array(chain.model.lowerPositionLimit)
            upper = np.array(chain.model.upperPositionLimit)
            with np.errstate(over="ignore"):  # limits of ±1.8e308 stand for none
                beyond = GOAL_BEYOND * (upper - lower)
            require_in_range("posture", chain, posture, beyond)
        else:
            posture = np.zeros(chain.nq)
        object.__setattr__(self, "posture", posture)
        if self.friction is not None:
            require_known_points(self.contacts)
        reading = choose_reading(self.reading, self.contacts, bodies)
        object.__setattr__(self, "reading", reading)
        if self.gains.force.integral * self.dt >= 1.0:
            raise InvalidInputError(
                f"force gain integral = {self.gains.force.integral:g} 1/s at a period of "
                f"{self.dt:g} s leaves no stability margin; keep integral × period below 1"
            )
        for arm, grasp in zip(chain.arms, chain.grasps, strict=True):
            if arm.model.nv > grasp.N.shape[1] and arm.passive_joints:
                raise ModelError(
                    f"arm '{arm.name}' has {arm.model.nv} joints, {len(arm.passive_joints)} of "
                    f"them passive, to move the object in {grasp.N.shape[1]} ways: posture torques "
                    "for redundant arms need a motor in every joint"
                )


def _definite(B: Array) -> Array:
    """B itself, if it is symmetric positive definite."""
    scale = np.sqrt(np.diag(B)) if np.diag(B).min() > 0.0 else np.ones(6)
    scaled = B / np.outer(scale, scale)
    if np.abs(scaled - scaled.T).max() > 1e-9 or np.linalg.eigvalsh(scaled)[0] <= 1e-12:
        raise InvalidInputError("the metric B of eq. 24 must be symmetric positive definite")
    return B
