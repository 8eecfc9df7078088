"""What a controller is made of: its arguments, validated once and never changed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from osc_contact.contacts.pairs import ContactPair
from osc_contact.contacts.pairs.keys import require_object_fits, store
from osc_contact.contacts.pairs.pair import knows_where_it_slides
from osc_contact.dynamics.arm import stretched_length
from osc_contact.dynamics.assembly import require_in_range
from osc_contact.dynamics.closed_chain import ClosedChain
from osc_contact.dynamics.environment import Body
from osc_contact.errors import InvalidInputError, ModelError, as_tuple, brief, require_kind
from osc_contact.projections import unit_diagonal
from osc_contact.robots.model import position_limits
from osc_contact.settings.control import (
    Friction,
    Gains,
    JointFriction,
    PhaseSettings,
    PostureTask,
    SafetySettings,
)
from osc_contact.spatial import Array, as_array

# Contact forces are computed from wrist readings by the filter of fig. 5 or by least squares. The
# filter attributes every contact force to N_μα; it is exact without friction or with known
# friction, for any motion of the object. Least squares include tangential forces at each point of
# contact (`osc_contact.law.reading`): neither friction nor a wrong normal changes the result, but
# it depends on the commanded acceleration of the object. The result is unique if all points
# are in one plane, perpendicular to the common normal. Two points elsewhere can push against each
# other along the line between them; the smallest of such pushes is assumed. The filter attributes
# friction of existing contacts to a missing contact; least squares do not.


Reading = Literal["filter", "least_squares"]

#: Of a joint's range; how far beyond its limits `posture` may lie. It is a goal that the push away
#: from the limits keeps the joint from reaching, so a goal just outside does no harm; one that is
#: further out than this is given in other units (degrees, mm).
GOAL_BEYOND = 1.5


#: s; a longer control period is given in another unit: motion at 10 Hz is no control of force.
LONGEST_PERIOD = 0.1
#: What settings are, and how they are written in a program.
_KINDS: dict[str, tuple[type, str]] = {
    "gains": (Gains, "osc.Gains(osc.MotionGains(frequency=3.0), osc.ForceGains(bandwidth=5.0))"),
    "posture_task": (PostureTask, "PostureTask(stiffness=10.0)"),
    "friction": (Friction, "osc.Friction(mu=0.2)"),
    "life": (PhaseSettings, "osc.PhaseSettings(), or None for contacts that are made already"),
    "safety": (SafetySettings, "osc.SafetySettings(), whose keys are its limits"),
    "joint_friction": (JointFriction, "osc.JointFriction(), or True or False"),
}


@dataclass(frozen=True, eq=False)
class Settings:
    """All settings of a controller, see `Controller`; a `reading` of None is replaced by a choice.

    Raises:
        InvalidInputError: an object of another class, dt not positive or above 0.1 s, an unknown
            metric, a posture far outside the joints' limits, or contacts and an arm without a wrist
            sensor, so that contact forces cannot be measured.
        ModelError: a redundant arm with passive joints.
    """

    chain: ClosedChain
    contacts: Sequence[ContactPair]
    gains: Gains
    dt: float
    B: Array | str
    bodies: Sequence[Body | None]
    posture: Array | None
    posture_task: PostureTask
    friction: Friction | None
    life: PhaseSettings | None
    safety: SafetySettings
    joint_friction: JointFriction | bool | None
    reading: Reading | None

    def __post_init__(self) -> None:
        self._require_kinds()
        chain = self.chain
        self._require_period()
        if isinstance(self.B, str):
            if self.B not in ("object", "chain"):
                raise InvalidInputError(
                    f"B = '{self.B}'; give 'object', 'chain' or a (6, 6) matrix"
                )
        else:
            store(self, B=as_array("B", self.B, (6, 6)))
            unit_diagonal(self.B, "the metric B of eq. 24", "an inverse inertia", InvalidInputError)
        contacts = self._listed_contacts()
        blind = [arm.name for arm in chain.arms if arm.wrist_sensor is None]
        if contacts and blind:
            raise InvalidInputError(
                "contact forces are measured in the wrists of all arms together, but "
                f"{blind} have no wrist_sensor; name its frame when loading the arm"
            )
        bodies = as_tuple("Controller: bodies", self.bodies, "[None, osc.Yielding()]")
        bodies = bodies or (None,) * len(contacts)
        if len(bodies) != len(contacts):
            raise InvalidInputError(
                f"{len(contacts)} contacts but {len(bodies)} bodies; give one for each contact"
            )
        posture = np.zeros(chain.nq)
        if self.posture is not None:
            posture = as_array("posture", self.posture, (chain.nq,))
            lower, upper = position_limits(chain.model)
            with np.errstate(over="ignore"):  # limits of ±1.8e308 stand for none
                beyond = GOAL_BEYOND * (upper - lower)
            require_in_range("posture", chain, posture, beyond)
        for pair in contacts:
            if self.friction is not None and not knows_where_it_slides(pair):
                raise InvalidInputError(
                    f"contact '{pair.name}' is a {type(pair).__name__}, which has no points of "
                    "contact, so its friction is not known. Leave control.friction out, or give "
                    "the pair a method points_of_contact(X_WO, X_WE)"
                )
        how = self.joint_friction
        store(
            self,
            contacts=contacts,
            bodies=bodies,
            posture=posture,
            joint_friction=JointFriction() if how is True else how or None,
            reading=choose_reading(self.reading, contacts),
        )
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

    def _require_kinds(self) -> None:
        """Refuse objects of other classes: numbers, truth values, groups of keys."""
        require_kind("Controller", self.chain, ClosedChain, "osc.ClosedChain([arm])")
        for name, (kind, example) in _KINDS.items():
            value = getattr(self, name)
            if value is not None and not (name == "joint_friction" and isinstance(value, bool)):
                require_kind(f"{name}=", value, kind, example)

    def _require_period(self) -> None:
        """Refuse a control period that is not positive, or too long to be in seconds."""
        try:
            dt = float(self.dt)
        except (TypeError, ValueError):
            dt = np.nan
        if not (np.isfinite(dt) and dt > 0.0):
            raise InvalidInputError(
                f"dt = {brief(self.dt)}; give the control period in seconds, > 0, such as 1e-3"
            )
        if dt > LONGEST_PERIOD:
            raise InvalidInputError(
                f"dt = {dt:g} s, longer than {LONGEST_PERIOD:g} s; give the control period in "
                f"seconds: {1e-3 * dt:g} for {dt:g} ms, {1.0 / dt:.3g} for a rate of {dt:g} Hz"
            )
        store(self, dt=dt)

    def _listed_contacts(self) -> tuple[ContactPair, ...]:
        """Check the contact pairs and their sizes; return them as a tuple."""
        example = "[osc.VertexOnFace([0, 0, 0], point=p, normal=n)]"
        contacts = as_tuple("Controller: contacts", self.contacts, example)
        for pair in contacts:
            if not isinstance(pair, ContactPair):
                raise InvalidInputError(
                    f"Controller: contacts has {brief(pair)}, which is no contact pair: it lacks "
                    f"name, contact or gaps; give pairs, such as {example}"
                )
            require_object_fits(pair, max(map(stretched_length, self.chain.arms)))
        return contacts


def choose_reading(requested: Reading | None, pairs: Sequence[ContactPair]) -> Reading:
    """Choose the method of computing contact forces: least squares if a pair has known points.

    Args:
        requested: method that the user requests, or None. pairs: contact pairs.

    Raises:
        InvalidInputError: the requested method is unknown.
    """
    if requested not in (None, "filter", "least_squares"):
        raise InvalidInputError(
            f"reading = '{requested}'; give 'filter', 'least_squares' or None, which chooses"
        )
    if requested is not None:
        return requested
    return "least_squares" if any(map(knows_where_it_slides, pairs)) else "filter"
