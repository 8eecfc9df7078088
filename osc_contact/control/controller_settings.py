"""Settings of a controller: its arguments, validated once and never changed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from osc_contact.contacts.pairs import ContactPair
from osc_contact.contacts.pairs.keys import require_object_fits, store
from osc_contact.contacts.pairs.pair import has_known_points
from osc_contact.dynamics.arm import stretched_length
from osc_contact.dynamics.assembly import require_in_range
from osc_contact.dynamics.closed_chain import ClosedChain
from osc_contact.dynamics.environment import Body
from osc_contact.errors import InvalidInputError, ModelError, as_tuple, brief, require_kind
from osc_contact.projections import unit_diagonal
from osc_contact.robots.model import position_limits
from osc_contact.settings.control import (
    Friction,
    JointFriction,
    PhaseSettings,
    PostureTask,
    SafetySettings,
)
from osc_contact.settings.gains import Gains
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

#: Largest distance of `posture` beyond the joints' limits, as a share of a joint's range. Joints
#: never reach a goal beyond their limits, because the posture task pushes them away from these; a
#: goal just outside is therefore harmless. A goal farther out is in a wrong unit (degrees, mm).
GOAL_BEYOND = 1.5


#: Longest control period (s); a larger number is in a wrong unit, since forces cannot be controlled
#: at 10 Hz.
LONGEST_PERIOD = 0.1
#: Class of each setting, and an example for messages.
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
    """Settings of a controller with their checks, see `Controller` for their meaning.

    `reading` = None is replaced by the method that `choose_reading` selects.

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
        """Check all settings, and replace lists, numbers and omitted values by checked ones.

        Contacts and bodies become tuples, the posture an array (n,; rad, m), joint friction its
        settings or None, and the method of reading contact forces is chosen for the contacts if it
        is not given.

        Raises:
            InvalidInputError, ModelError: see the class.
        """
        self._require_kinds()
        self._require_period()
        self._require_metric()
        contacts = self._listed_contacts()
        bodies = self._listed_bodies(contacts)
        posture = self._checked_posture()
        # friction acts at points of contact, which every pair must therefore know
        for pair in contacts:
            if self.friction is not None and not has_known_points(pair):
                raise InvalidInputError(
                    f"contact '{pair.name}' is a {type(pair).__name__}, which has no points of "
                    "contact, so its friction is not known. Leave control.friction out, or give "
                    "the pair a method points_of_contact(X_WO, X_WE)"
                )
        joint_friction = self.joint_friction
        if isinstance(joint_friction, bool):
            joint_friction = JointFriction() if joint_friction else None
        store(
            self,
            contacts=contacts,
            bodies=bodies,
            posture=posture,
            joint_friction=joint_friction,
            reading=choose_reading(self.reading, contacts),
        )
        # an integrator with gain K whose effect is measured one period dt later needs K dt < 1
        if self.gains.force.integral * self.dt >= 1.0:
            raise InvalidInputError(
                f"force gain integral = {self.gains.force.integral:g} 1/s at a period of "
                f"{self.dt:g} s leaves no stability margin; keep integral × period below 1"
            )
        self._require_motors()

    def _require_metric(self) -> None:
        """Refuse a metric B of eq. 24 that is unknown or not positive definite; store an array.

        Raises:
            InvalidInputError: another name than "object" or "chain", or a matrix that is not a
                positive definite (6, 6).
        """
        if isinstance(self.B, str):
            if self.B not in ("object", "chain"):
                raise InvalidInputError(
                    f"B = '{self.B}'; give 'object', 'chain' or a (6, 6) matrix"
                )
        else:
            store(self, B=as_array("B", self.B, (6, 6)))
            unit_diagonal(self.B, "the metric B of eq. 24", "an inverse inertia", InvalidInputError)

    def _listed_bodies(self, contacts: tuple[ContactPair, ...]) -> tuple[Body | None, ...]:
        """Return the touched body of each contact as a tuple; require a wrist sensor in each arm.

        Args:
            contacts: checked contact pairs.

        Returns:
            (contacts,) bodies; None for a body whose motion does not depend on contact forces.

        Raises:
            InvalidInputError: contacts and an arm without a wrist sensor, or another number of
                bodies than of contacts.
        """
        blind = [arm.name for arm in self.chain.arms if arm.wrist_sensor is None]
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
        return bodies

    def _checked_posture(self) -> Array:
        """Return the goal (n,) of the posture task (rad, m), zeros if it is omitted.

        Raises:
            InvalidInputError: a goal beyond a joint's limits by more than `GOAL_BEYOND` ranges.
        """
        chain = self.chain
        if self.posture is None:
            return np.zeros(chain.nq)
        posture = as_array("posture", self.posture, (chain.nq,))
        lower, upper = position_limits(chain.model)
        with np.errstate(over="ignore"):  # limits of ±1.8e308 mean no limit
            tolerance = GOAL_BEYOND * (upper - lower)
        require_in_range("posture", chain, posture, tolerance)
        return posture

    def _require_motors(self) -> None:
        """Refuse redundant arms with passive joints, in which posture torques cannot be applied.

        Raises:
            ModelError: an arm has more joints than its grasp transmits forces, and not all of them
                have motors.
        """
        for arm, grasp in zip(self.chain.arms, self.chain.grasps, strict=True):
            if arm.model.nv > grasp.N.shape[1] and arm.passive_joints:
                raise ModelError(
                    f"arm '{arm.name}' has {arm.model.nv} joints, {len(arm.passive_joints)} of "
                    f"them passive, to move the object in {grasp.N.shape[1]} ways: posture torques "
                    "for redundant arms need a motor in every joint"
                )

    def _require_kinds(self) -> None:
        """Refuse settings of a wrong class, such as a number or a dictionary in place of `Gains`.

        Raises:
            InvalidInputError: with the setting and an example.
        """
        require_kind("Controller", self.chain, ClosedChain, "osc.ClosedChain([arm])")
        for name, (kind, example) in _KINDS.items():
            value = getattr(self, name)
            if value is not None and not (name == "joint_friction" and isinstance(value, bool)):
                require_kind(f"{name}=", value, kind, example)

    def _require_period(self) -> None:
        """Refuse a control period (s) that is not positive or too long; store it as a float.

        Raises:
            InvalidInputError: dt is no finite number, not above 0 or above `LONGEST_PERIOD`.
        """
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
        """Check the contact pairs and their sizes; return them as a tuple.

        Raises:
            InvalidInputError: an object that is no pair, or a pair whose points on the object are
                farther from its origin than the longest arm reaches (metres taken for millimetres).
        """
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
    """Choose the method by which contact forces are computed from the wrists' readings.

    Args:
        requested: method that the user requests; None: no request.
        pairs: contact pairs of the controller.

    Returns:
        The requested method. Without a request "least_squares" if a pair pushes at known points,
        because friction then does not change the result; "filter" if the points of all pairs are
        unknown, which least squares need.

    Raises:
        InvalidInputError: the requested method is unknown.
    """
    if requested not in (None, "filter", "least_squares"):
        raise InvalidInputError(
            f"reading = '{requested}'; give 'filter', 'least_squares' or None for the default"
        )
    if requested is not None:
        return requested
    return "least_squares" if any(map(has_known_points, pairs)) else "filter"
