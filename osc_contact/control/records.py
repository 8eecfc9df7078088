"""Records of one controller: MODEL packed from its settings, and views of all its bytes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import pinocchio as pin

from osc_contact.contacts.pairs import ContactPair
from osc_contact.contacts.pairs.keys import require_object_fits, store
from osc_contact.contacts.pairs.law_pair import PairRow, law_row
from osc_contact.contacts.pairs.pair import knows_where_it_slides, pushes_only
from osc_contact.control.status import LostDirection
from osc_contact.dynamics.arm import effort_scale, stretched_length
from osc_contact.dynamics.assembly import require_in_range
from osc_contact.dynamics.closed_chain import ClosedChain, pack_chain
from osc_contact.dynamics.environment import Body, Conveyor, Guided, Yielding
from osc_contact.errors import InvalidInputError, ModelError, as_tuple, brief, require_kind
from osc_contact.law import records as at
from osc_contact.law import vectors
from osc_contact.law.compiled import rows as law_rows
from osc_contact.law.holding import BRAKE_RATE
from osc_contact.law.records import Bytes, Rows, new_model, views
from osc_contact.law.safety import SURE
from osc_contact.projections import unit_diagonal
from osc_contact.robots.model import position_limits
from osc_contact.settings.control import (
    HEADROOM,
    LEAST_CEILING,
    Friction,
    Gains,
    JointFriction,
    PhaseSettings,
    PostureTask,
    SafetySettings,
)
from osc_contact.settings.quantities import Spec
from osc_contact.spatial import Array, as_array, norm

# Immutable settings of a controller, and the choice of `reading`.
#
# Contact forces are computed from wrist readings by the filter of fig. 5 or by least squares. The
# filter attributes every contact force to N_μα; it is exact without friction or with known
# friction, for any motion of the object. Least squares include tangential forces at each point of
# contact (`osc_contact.law.reading`): neither friction nor a wrong normal changes the result, but
# it depends on the commanded acceleration of the object. The result is unique if all points
# are in one plane, perpendicular to the common normal. Two points elsewhere can push against each
# other along the line between them; the smallest of such pushes is assumed. The filter attributes
# friction of existing contacts to a missing contact; least squares do not.


Reading = Literal["filter", "least_squares"]

#: Permitted distance of `posture` beyond a joint's limits, as a share of its range. A goal slightly
#: outside is harmless, because the joint is repelled by its limits; a goal further outside suggests
#: another unit (degrees, mm).
GOAL_BEYOND = 1.5


#: s, longest control period; a longer one suggests another unit.
LONGEST_PERIOD = 0.1
#: Classes of settings, with an example for error messages.
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


_GIVEN = PairRow(at.GIVEN, ())
#: Kinds of bodies that the law evaluates, and their parameters.
_BODIES: dict[type, tuple[int, tuple[str, ...]]] = {
    type(None): (at.UNYIELDING, ()),
    Conveyor: (at.CONVEYOR, ()),
    Yielding: (at.YIELDING, ("compliance",)),
    Guided: (at.CART, ("direction", "inertia", "stiffness", "damping", "preload", "descent")),
}
_NEVER = 1e12  #: ticks, in place of an infinite time
_WHOLE = np.pi  #: rad or m, largest range of a joint in the posture task
SLIP = 3e-4  #: rad/s, s_0, speed of a revolute joint below which dry friction is regularised
SLIDING = 0.3  #: m/rad, factor of that speed for prismatic joints
_UNLIMITED = 100.0  #: N m, N, in place of the torque limit of a motor without one
_NOISE = 0.003  #: noise of residuals, as a share of the torque limit
_ROUNDING = 2e-4  #: residuals of an exact model in discrete time, as a share of the torque limit
#: Number of standard deviations by which friction must be significant if the model has none.
_SURELY = 2.0
# Priors of F, D, A, bias and μ, in units of the largest friction torque (D and A at 1 rad/s and
# 1 rad/s²): standard deviation at the start, to which half of the model's value is added; largest
# standard deviation; bound.
_DOUBT = np.array([0.07, 0.07, 0.07, 0.017, 0.07])
_SPREAD = np.array([0.5, 0.5, 0.5, 0.5, 0.2])
_BOUND = np.array([1.0, 20.0, 20.0, 1.0, 0.5])


def pack_model(settings: Settings, columns: dict[int, int]) -> Bytes:
    """Pack settings into the bytes of MODEL, which also determine the sizes of MEMORY and WORK.

    Args:
        settings: settings of the controller.
        columns: number of columns of N of each pair that is evaluated by Python, by the index of
            the pair; missing ones are 0.
    """
    chain = settings.chain
    pairs = [law_row(pair) or _GIVEN for pair in settings.contacts]
    counts = [
        columns.get(number, 0) if row.kind == at.GIVEN else len(row.shapes) - row.freedoms
        for number, row in enumerate(pairs)
    ]
    shapes = [shape for row in pairs for shape in row.shapes]
    raw = new_model(len(chain.arms), chain.nq, chain.n_a, len(pairs), len(shapes), sum(counts))
    head = at.MODEL.view(raw)
    pack_chain(chain, raw, chain.leader)
    _pack_joints(settings, head)
    first_column = first_shape = 0
    for number, row in enumerate(pairs):
        r = counts[number]
        contact = settings.contacts[number]
        touched = settings.bodies[number]
        pair = head.pairs[number]
        body = head.bodies[number]
        pair.kind = row.kind
        pair.first = first_column
        pair.count = r
        pair.shape_at = first_shape
        pair.freedoms = row.freedoms
        pair.address = row.address
        pair.has_friction = knows_where_it_slides(contact)
        head.columns.contact[first_column : first_column + r] = number
        body.pushes = pushes_only(contact)
        body.kind, names = _BODIES.get(type(touched), (at.ELSEWHERE, ()))
        body.same = number if touched is None else settings.bodies.index(touched)
        given: Any = touched
        if isinstance(touched, Guided):
            given = touched.rail
            if given.joints == [1]:
                body.kind = at.ELSEWHERE
        numbers = np.hstack([[], *(getattr(given, name) for name in names)])
        body.parameters[: len(numbers)] = numbers
        first_column += r
        first_shape += len(row.shapes)
    head.shapes.row[:] = np.reshape(shapes, (-1, 16))
    pack_gains(settings, head)
    pack_safety(settings, head)
    return raw


#: Fields of gains in MODEL, and in the contacts of MEMORY if there are no phases.
GAIN_FIELDS: dict[str, tuple[str, str]] = {
    "motion.stiffness": ("stiffness", ""),
    "motion.damping": ("damping", ""),
    "motion.integral": ("integral", ""),
    "force.integral": ("force_gain", "gain"),
    "force.damping": ("force_damping", "damping"),
}


#: Keys of `PhaseSettings` that have another name in MODEL.
PHASE_NAMES = {
    "speed": "approach_speed",
    "damping": "approach_damping",
    "least": "least_force",
    "share": "lost_share",
    "torque_rate": "phase_rate",
}


def pack_gains(settings: Settings, head: Any) -> None:
    """Pack gains, phases, friction, metric and period into MODEL.

    These settings may differ between controllers of the same structure.
    """
    dt = settings.dt
    motion = settings.gains.motion
    force = settings.gains.force
    _copy(motion, head)
    head.period = dt
    _copy(
        force,
        head,
        integral="force_gain",
        damping="force_damping",
        brake="force_brake",
        rise="step_time",
    )
    drifts = force.brake > 0.0 or force.tilt > 0.0
    head.drift_share = -np.expm1(-force.drift * dt) if drifts else 0.0
    head.tilt = 2.0 * np.sin(0.5 * force.tilt)  # chord of the angle
    _copy(settings.posture_task, head, stiffness="posture_stiffness", damping="posture_damping")
    _copy(settings.friction or Friction(mu=0.0), head)
    _pack_friction(settings, head)
    head.reading = at.LEAST_SQUARES if settings.reading == "least_squares" else at.FILTER
    B = settings.B
    kinds = {"object": at.BY_OBJECT, "chain": at.BY_CHAIN}
    head.metric = kinds[B] if isinstance(B, str) else at.BY_MATRIX
    head.B_inv[:] = np.eye(6) if isinstance(B, str) else np.linalg.inv(B)
    head.phased = settings.life is not None
    # also without phases, as torques change slowly after a change of the active set
    _copy(settings.life or PhaseSettings(), head, **PHASE_NAMES)


def pack_safety(settings: Settings, head: Any) -> None:
    """Pack limits of the robot and settings of holds and stops into MODEL."""
    safety = settings.safety
    _copy(safety, head, stop_after="fault_ticks")
    # s from the decision to stop until the brakes act, for the stopping distance
    head.reaction = 0.5 / safety.hold_rate + 0.5 / BRAKE_RATE + SURE
    for key in ("contact", "wrist"):  # ceilings that are not given rise with the commands
        given = getattr(safety, f"{key}_ceiling")
        setattr(head, f"{key}_ceiling", LEAST_CEILING if given is None else given)
        setattr(head, f"{key}_headroom", HEADROOM if given is None else 0.0)
    head.guarded = 1
    head.fast_ticks = round(min(safety.overspeed_time / settings.dt, _NEVER))
    weight = 9.81 * settings.chain.reference.inertia.mass
    head.force_range = max(safety.force_range, 3.0 * weight)
    head.torque_range = max(safety.torque_range, 3.0 * weight)  # on a lever of 1 m
    model = settings.chain.model
    rows = head.joints
    watched = (rows.motor >= 0) & (safety.brake_time > 0.0)
    rows.lower[:] = np.where(watched, model.lowerPositionLimit, -np.inf)
    rows.upper[:] = np.where(watched, model.upperPositionLimit, np.inf)
    rows.brake[:] = 0.5 * safety.brake_time / rows.speed_max


def _pack_joints(settings: Settings, head: Any) -> None:
    chain = settings.chain
    posture = settings.posture_task
    rows = head.joints
    margins = joint_limit_margins(chain.model, posture.limit_stiffness, posture.limit_margin)
    effort = effort_scale(chain.tau_max)
    rows.motor[chain.actuated] = np.arange(chain.n_a)
    rows.effort[chain.actuated] = effort**2
    rows.tau_max[chain.actuated] = chain.tau_max
    rows.ease[chain.actuated] = 1.0 / effort**2
    speed = chain.model.velocityLimit
    rows.rated[:] = np.where(np.isfinite(speed) & (speed > 0.0), speed, np.inf)
    rows.speed_max[:] = np.where(rows.motor < 0, np.inf, rows.rated)
    rows.posture[:] = settings.posture
    for name, values in zip(("low", "high", "width", "most"), margins, strict=True):
        rows[name][:] = values


def _pack_friction(settings: Settings, head: Any) -> None:
    """Pack the friction of the joints in the model, and the priors of its identification."""
    how: Any = settings.joint_friction
    if how is None:
        return
    model = settings.chain.model
    rows = head.joints
    known = np.zeros((len(rows), 5))
    known[:, 0] = model.upperDryFrictionLimit
    known[:, 1] = model.damping
    head.rubs = how.learning or how.errors or known.any()
    head.friction_learning = how.learning
    head.friction_errors = bool(how.errors)
    head.friction_share = how.share
    head.friction_smoothing = how.smoothing
    limit = np.minimum(rows.tau_max, _UNLIMITED)
    most = how.most * limit
    priors = head.priors
    priors.noise[:] = _NOISE * limit
    priors.rounding[:] = _ROUNDING * limit
    rows.slip[:] = np.where(rows.slides != 0, SLIDING * SLIP, SLIP)
    rows.theta[:] = known
    scale = np.ones_like(known)
    scale[:, :4] = most[:, None]
    priors.sure[:] = np.where(known.sum(axis=1) > priors.noise, 0.0, _SURELY)
    priors.doubt[:] = 0.5 * known + scale * _DOUBT
    priors.spread[:] = scale * _SPREAD
    priors.high[:] = np.maximum(scale * _BOUND, known)
    priors.low[:, 2] = -np.array(model.armature)  # F and D cannot be below zero
    priors.low[:, 3:] = -priors.high[:, 3:]


def joint_limit_margins(
    model: pin.Model, stiffness: float, margin: float
) -> tuple[Array, Array, Array, Array]:
    """Margins of the joint limits in which the posture task repels joints, (n,) each.

    At the depth s in a margin of width w (0 at its beginning, 1 at the limit and beyond) a joint is
    repelled by a = k w (3s² − 2s³), the slope of the potential k w² (s³ − s⁴/2): continuous with
    its first derivative, and at most k w (a potential field after Khatib, 1986).

    Args:
        model: model of all arms. stiffness: k (1/s²). margin: width as a share of a joint's range,
            of which at most π (rad or m) is counted.

    Returns:
        Beginning of the lower and of the upper margins (∓inf without a limit), widths w, and k w.
    """
    lower, upper = position_limits(model)
    with np.errstate(over="ignore"):  # limits of ±1.8e308 stand for none
        width = margin * np.minimum(upper - lower, _WHOLE)
    return lower + width, upper - width, width, stiffness * width


def _copy(settings: Spec, head: Any, **names: str) -> None:
    """Copy settings into the fields of MODEL with the same names, or with those in `names`."""
    for key in type(settings).model_fields:
        value = getattr(settings, key)
        if value is not None and (name := names.get(key, key)) in at.MODEL.dtype.names:
            setattr(head, name, value)


STILL = np.zeros((0, 28))  #: motion of the touched bodies if all of them rest
UNNAMED = np.zeros(0)  #: active set of a reference that does not name one
_WHOLE_TICK = 0, at.LOOK, at.END


class TickRecords:
    """Views of MODEL, MEMORY and WORK of one controller.

    Attributes:
        rows: the array of bytes. index: row of the controller. at: offset of the JOB.
        model, memory, work: records, see `law.records`. model_bytes, memory_bytes, work_bytes:
            their bytes.
    """

    def __init__(self, rows: Rows | Bytes, index: int = 0, thread: int = 0) -> None:
        """Make views of a row of `rows`, or of new records with the bytes of a MODEL.

        Args:
            rows: records of controllers, or bytes of a MODEL. index: row. thread: thread whose WORK
                is used.
        """
        self.rows = rows = rows if isinstance(rows, Rows) else Rows(rows)
        self.index = index
        self.at = rows.starts[thread]
        self.model_bytes: Bytes = rows.model[index]
        self.memory_bytes: Bytes = rows.memory[index]
        self.work_bytes: Bytes = rows.work[thread]
        self._job = rows.jobs[thread].view(np.int64)  # `switches`, `begin` and `stop` first
        self.model, self.memory, self.work, _ = views(rows, index, thread)

    def run(
        self, given: tuple[Any, ...], flags: int = 0, begin: int = at.LOOK, stop: int = at.END
    ) -> int:
        """Run parts of a tick.

        Args:
            given: q, v, wrenches, X_WD, V_D, A_D, alpha_d, touched, active.
            flags: flags of `law.tick`.
            begin, stop: first part, and the part before which to stop.

        Returns:
            The result of `law.tick.rows`, which is 2 for one row that ended OK.
        """
        self._job[:3] = flags, begin, stop
        try:
            return int(law_rows()(self.rows.raw, 0, given))
        finally:
            self._job[:3] = _WHOLE_TICK

    def hold(self, q: Array, v: Array, reading: float = np.nan, begin: int = at.LOOK) -> None:
        """Run a tick, or one part of it, without a reference.

        Args:
            q, v: (n,) joint positions and velocities. reading: value of all wrist readings; NaN
                makes the tick one that cannot be computed. begin: first part.
        """
        wrenches = np.full((len(self.model.arms), 6), reading)
        six = np.zeros(6)
        self.run((q, v, wrenches, np.eye(4), six, six, np.zeros(0), STILL, UNNAMED), begin=begin)

    def places(self, *parts: Array) -> Array:
        """Indices (k,) in `rows.numbers` of the elements of some views, in sequence.

        Args:
            parts: arrays of eight-byte elements that share the memory of `rows`.
        """
        every = np.arange(len(self.rows.numbers))
        start = self.rows.raw.ctypes.data
        own = (
            np.ndarray(part.shape, every.dtype, every, part.ctypes.data - start, part.strides)
            for part in parts
        )
        return np.concatenate([one.ravel() for one in own])

    def copy(self) -> TickRecords:
        """Copy of the records in separate bytes."""
        other = TickRecords(self.model_bytes)
        other.memory_bytes[:] = self.memory_bytes
        other.work_bytes[:] = self.work_bytes
        return other

    # --- energy coordinates, turned, and back ----------------------------------------------------

    def reflection(self) -> Array:
        """Matrix (6, 6) that turns energy coordinates to locked axes first."""
        return vectors.reflection(self.work)

    def motions(self) -> Array:
        """Matrix (6, 6) from energy coordinates to motions at O in world axes."""
        return vectors.motions(self.work)

    def acceleration(self) -> Array:
        """Commanded spatial acceleration (6,) of the object at O (m/s², rad/s²)."""
        return self.motions() @ (self.reflection().T @ self.work.acceleration_t)

    def kept(self) -> Array:
        """Indices (r,) of the independent columns of N among all."""
        return self.work.kept[: int(self.work.rank)]

    def shares(self) -> Array:
        """Coordinates R (r, count) of the active columns of N in the independent ones."""
        chosen = self.work.chosen[: int(self.work.count)]
        return self.work.columns.share[chosen, : int(self.work.rank)].T.copy()

    def lost_directions(self, names: list[str]) -> tuple[LostDirection, ...]:
        """Directions that arms near singular postures lose.

        Args:
            names: names of the arms.
        """
        if not self.work.n_lost:
            return ()
        to_motion = self.motions() / self.model.reference
        out = []
        for name, arm in zip(names, self.work.arms, strict=True):
            for e in range(int(arm.n_lost)):
                twist = to_motion @ arm.lost[e]
                size = norm(twist[:3]) or norm(twist[3:])
                ratio = 1.0 / max(float(arm.chi[e]), 1e-12) ** 2
                out.append(LostDirection(name, float(arm.share[e]), ratio, twist / size))
        return tuple(out)
