"""What a controller is made of: taken once, never changed.

Contact forces are read off the wrists by the filter of fig. 5, or by least squares. The filter
takes all that pushes at a contact for N_μα: it is exact without friction, or with friction known,
whatever the object does. Least squares let each point of contact push along its tangents, too
(`osc_contact.law.reading`): neither friction nor a wrong normal changes their answer, but it
depends on the commanded acceleration of the object. The answer is unique where the columns of N
are independent of the tangents. Two points can always push against one another along the line
between them; so the points must lie in one plane, whose normal is that of them all.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from osc_contact.contacts.pairs import ContactPair, FaceOnVertex
from osc_contact.contacts.pairs.pair import count_forces, knows_where_it_slides
from osc_contact.contacts.pairs.points_on_planes import PointsOnPlanes
from osc_contact.dynamics.assembly import require_in_range
from osc_contact.dynamics.closed_chain import ClosedChain
from osc_contact.dynamics.environment import Body
from osc_contact.errors import InvalidInputError, ModelError
from osc_contact.scenarios.control_schema import (
    Friction,
    Gains,
    JointFriction,
    PhaseSettings,
    PostureTask,
    SafetySettings,
)
from osc_contact.spatial import Array, as_array

Reading = Literal["filter", "least_squares"]

_SAME = 1e-3  #: normals and planes (m) that differ by less are one

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
    joint_friction: JointFriction | None = field(default_factory=JointFriction)
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
            _require_known_points(self.contacts)
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


def choose_reading(
    requested: Reading | None,
    pairs: Sequence[ContactPair],
    bodies: Sequence[Body | None],
) -> Reading:
    """What is requested, or the better one: least squares where their answer is unique.

    Args:
        requested: None: choose. pairs: the contacts. bodies: of each.

    Raises:
        InvalidInputError: unknown, or least squares where they are not possible.
    """
    if requested not in (None, "filter", "least_squares"):
        raise InvalidInputError(
            f"reading = '{requested}'; give 'filter', 'least_squares' or None, which chooses"
        )
    unknown = [pair.name for pair in pairs if not knows_where_it_slides(pair)]
    if requested == "least_squares" and unknown:
        raise InvalidInputError(
            f"reading = 'least_squares' needs contacts that know where they touch; {unknown} do "
            "not. Give 'filter'"
        )
    if requested is not None:
        return requested
    unique = pairs and not unknown and _in_one_plane(pairs, bodies)
    return "least_squares" if unique else "filter"


def _in_one_plane(pairs: Sequence[ContactPair], bodies: Sequence[Body | None]) -> bool:
    """Whether all points of contact stay in one plane, of the environment or of the object."""
    if any(body is not bodies[0] for body in bodies):
        return False
    planes: list[tuple[float, ...]] = []
    for pair in pairs:
        if isinstance(pair, PointsOnPlanes):
            columns = zip(pair._into.T, pair._heights, strict=True)
            planes.extend((*into, height, 0.0) for into, height in columns)
        elif isinstance(pair, FaceOnVertex):
            planes.append((*pair.normal, float(pair.normal @ pair.point), 1.0))
        elif len(pairs) > 1 or count_forces(pair) > 1:
            return False
        else:
            planes.append((0.0,) * 5)  # one point
    return bool(np.ptp(np.array(planes), axis=0).max() < _SAME)


def _require_known_points(pairs: Sequence[ContactPair]) -> None:
    """Refuse contacts that do not know where they touch.

    Raises:
        InvalidInputError: with the contact's name.
    """
    for pair in pairs:
        if not knows_where_it_slides(pair):
            raise InvalidInputError(
                f"contact '{pair.name}' is a {type(pair).__name__}, which has no points of "
                "contact, so its friction is not known. Leave control.friction out, or give the "
                "pair a method points_of_contact(X_WO, X_WE)"
            )
