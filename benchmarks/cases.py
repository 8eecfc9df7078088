"""Rigs whose ticks are timed, each at an instant of a motion on its contacts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

import osc_contact as osc
from osc_contact import robots
from osc_contact.contacts.pairs.points_on_planes import VertexOnFace
from osc_contact.control.controller import Controller
from osc_contact.control.status import Status
from osc_contact.dynamics.assembly import close, object_pose, reach
from osc_contact.dynamics.closed_chain import ClosedChain
from osc_contact.interface import Measurement, Reference
from osc_contact.lab.plants.rigid import RigidPlant
from osc_contact.settings.control import PhaseSettings, SafetySettings
from osc_contact.settings.gains import Gains
from osc_contact.spatial import Array

#: A Panda that slides a ball-nosed peg in a circle on a tilted face with 10 N, as a scenario.
POINT = osc.load_scenario("panda_dome").as_dict()
POINT |= {
    "name": "point",
    "description": "",
    "environment": [],
    "contacts": [
        {
            "name": "nose",
            "type": "vertex_on_face",
            "vertex": [0, 0, -0.15],
            "radius": "12 mm",
            "face": {
                "urdf": "face.urdf",
                "point": [0.49, 0, 0.24],
                "normal": [-0.34202, 0, 0.93969],
            },
        }
    ],
    "force": {"nose": [{"type": "constant", "value": "10 N"}]},
    "motion": [
        {
            "kind": "linear",
            "direction": direction,
            "signals": [
                {
                    "type": "sine",
                    "amplitude": "40 mm",
                    "frequency": "0.5 Hz",
                    "ramp": "1 s",
                    "phase": phase,
                }
            ],
        }
        for direction, phase in (([0, 1, 0], 0), ([0.93969, 0, 0.34202], "90 deg"))
    ],
    "gains": {"motion": {"stiffness": 900, "damping": 60}, "force": {"integral": 30}},
    "control": {"rate": "1 kHz"},
    "plant": {"type": "mujoco", "step": "0.25 ms"},
    "duration": 3,
}

DT = 1e-3  #: control period (s)
MOVING_TICKS = 40  #: number of ticks of the motion before the instant of a case
ROD = pin.Inertia(1.5, np.array([0.01, -0.004, 0.006]), np.diag([2e-3, 0.045, 0.044]))
END = np.array([0.29, 0.0, 0.0])  #: centre of the ball at one end of the rod (m)
RADIUS = 0.01  #: radius of this ball, as of the packaged rod (m)
PANDA_Q = np.array([0.0, -0.3, 0.0, -2.2, 0.0, 2.0, 0.78])  #: positions of a Panda's joints (rad)
GAINS = Gains(
    motion=osc.MotionGains(stiffness=900.0, damping=60.0),
    force=osc.ForceGains(integral=30.0, damping=100.0),
)


Timed = tuple[Callable[[], Array], Callable[[], None]]
"""Function to be timed, and function that is called after each call of it."""


def repeatable(controller: Controller) -> Controller:
    """Copy of a controller whose tick can be repeated with identical readings.

    Rules that take identical readings for a fault of the sensors are switched off.

    Args:
        controller: controller with any safety settings.
    """
    rules = ("stuck_speed", "frozen_time", "speed_error", "position_drift", "wrist_error")
    return controller.with_safety(
        controller.settings.safety.replaced(**dict.fromkeys(rules, np.inf))
    )


@dataclass(frozen=True)
class TickCase:
    """Rig at one instant of a motion along its faces, with all contacts pressed.

    Attributes:
        name: name of the case.
        chain: arms and object.
        pairs: contacts.
        gains: gains of the controller.
        posture: (n,) joint positions of the posture task (rad, m).
        measurement: measurement at this instant.
        reference: reference at this instant.
        status: status of every tick at this instant.
        life: settings of the contact phases; None: contacts are always closed.
        safety: safety settings of the controller.
    """

    name: str
    chain: ClosedChain
    pairs: tuple[Any, ...]
    gains: Gains
    posture: Array
    measurement: Measurement
    reference: Reference
    status: Status = Status.OK
    life: PhaseSettings | None = None
    safety: SafetySettings = field(default_factory=SafetySettings)

    @property
    def given(self) -> tuple[Measurement, Reference]:
        """Measurement and reference of a tick at this instant."""
        return (self.measurement, self.reference)

    def controller(self) -> Controller:
        """New controller of this rig, which reads contact forces as the paper does (fig. 5)."""
        return Controller(
            self.chain,
            self.pairs,
            self.gains,
            dt=DT,
            posture=self.posture,
            life=self.life,
            reading="filter",
            safety=self.safety,
        )

    def tick(self, controller: Controller | None = None) -> Timed:
        """Function that computes a tick at this instant, and function to be called after each.

        The second one checks the status, and sets the integrals to zero, so that all ticks are
        equal.

        Args:
            controller: controller of the ticks; None: a new one.
        """
        ticked = controller or repeatable(self.controller())

        def unwind() -> None:
            """Set the integrals to zero.

            Raises:
                InvalidInputError: the tick ended with another status.
            """
            if ticked.status is not self.status:
                reason = f" ({ticked.reason})" if ticked.status.value else ""
                raise osc.InvalidInputError(
                    f"{self.name}: a timed tick ended {ticked.status.name}{reason}, expected "
                    f"{self.status.name}"
                )
            ticked.motion_integral = np.zeros(6)
            ticked.force_integral = np.zeros(0)

        return (partial(ticked.tick, *self.given), unwind)

    def floor(self) -> Callable[[], object]:
        """Function that calls `pin.computeAllTerms` of the same arms at the same q and v."""
        model = self.chain.model
        q, v = np.array([self.measurement.q, self.measurement.v], float)
        return partial(pin.computeAllTerms, model, model.createData(), q, v)


def in_motion(
    name: str,
    chain: ClosedChain,
    pairs: tuple[VertexOnFace, ...],
    q: Array,
    gains: Gains,
    reference: Callable[[float], Reference],
    status: Status = Status.OK,
) -> TickCase:
    """Make the case of a rig at the instant after `MOVING_TICKS` of a motion on the rigid plant.

    Args:
        name: name of the case.
        chain: arms and object.
        pairs: contacts.
        q: (n,) joint positions at the start, and of the posture task (rad, m).
        gains: gains of the controller.
        reference: function of the time (s).
        status: status of the ticks at this instant.
    """
    plant = RigidPlant(chain, pairs, DT)
    plant.reset(q)
    still = TickCase(name, chain, pairs, gains, q, plant.measure(), reference(0.0))
    osc.run_loop(plant, still.controller(), (reference(k * DT) for k in range(MOVING_TICKS)))
    end = reference(MOVING_TICKS * DT)
    return TickCase(name, chain, pairs, gains, q, plant.measure(), end, status)


def rod_rig() -> tuple[osc.Rig, tuple[VertexOnFace, ...]]:
    """Rig of the packaged scenario two_contact_rod, and its two contacts.

    Steps of the desired forces are not shaped, because the remainder of a step would make repeated
    ticks at one instant differ.
    """
    rig = osc.build_rig(osc.load_scenario("two_contact_rod", ["gains.force.rise=0 s"]))
    return (rig, tuple(pair for pair in rig.pairs if isinstance(pair, VertexOnFace)))


def two_contact_rod() -> TickCase:
    """Case of two SCARA arms with gripper hinges, a rod, two skew contacts: d = 5, r = 2."""
    rig, pairs = rod_rig()
    at = rig.references.at
    return in_motion("two_contact_rod", rig.chain, pairs, rig.q_contact, rig.gains, at)


def one_panda() -> TickCase:
    """Case of one Panda that presses one end of a rod on a face: d = 6, r = 1, n = 7."""
    arm = panda("arm", _at())
    chain = ClosedChain([arm], [_at(0.02, 0.01, 0.08)], osc.RigidObject(ROD))
    return _sliding("one_panda", chain, PANDA_Q, [END])


def two_pandas() -> TickCase:
    """Case of two Pandas that hold a rod, each end of it on a face: d = 6, r = 2."""
    arms = [panda("left", _at(-0.55)), panda("right", _at(0.55, yaw=np.pi))]
    grasps = [_at(-0.15, roll=np.pi).inverse(), _at(0.15, roll=np.pi, yaw=np.pi).inverse()]
    chain = ClosedChain(arms, grasps, osc.RigidObject(ROD))
    q = close(chain, reach(chain, np.tile(PANDA_Q, 2), _at(z=0.45)))
    return _sliding("two_pandas", chain, q, [-END, END])


CASES: dict[str, Callable[[], TickCase]] = {
    "two_contact_rod": two_contact_rod,
    "one_panda": one_panda,
    "two_pandas": two_pandas,
}


def _at(
    x: float = 0.0, y: float = 0.0, z: float = 0.0, *, roll: float = 0.0, yaw: float = 0.0
) -> pin.SE3:
    """Pose with a translation (m), rotated about x by `roll`, then about z by `yaw` (rad)."""
    return pin.SE3(pin.rpy.rpyToMatrix(roll, 0.0, yaw), np.array([x, y, z]))


def panda(name: str, base: pin.SE3) -> osc.Arm:
    """Make a Panda with locked fingers and a wrist sensor between its flange and its hand.

    Args:
        name: name of the arm.
        base: pose of its base in the world.
    """
    urdf, _ = robots.find_robot("panda")
    return osc.Arm.from_urdf(
        urdf, name=name, tip="panda_hand_tcp", base=base, wrist_sensor="panda_hand"
    )


def _sliding(name: str, chain: ClosedChain, q: Array, vertices: list[Array]) -> TickCase:
    """Make the case of a rod whose ends slide on faces, at 0.1 m/s across the rod.

    Each face leans towards its end, so that the rest of the rod does not touch it.

    Args:
        name: name of the case.
        chain: arms that hold the rod along x of the object.
        q: (n,) joint positions at the start (rad).
        vertices: points (3,) of the rod that touch, in the frame of the object (m).
    """
    X = object_pose(chain, q)
    up = np.array([0.0, 0.0, 1.0])
    pairs = []
    for i, vertex in enumerate(vertices):
        normal = _unit(up - 0.5 * _unit(X.rotation @ vertex))
        point = X.act(vertex) - RADIUS * normal
        pairs.append(VertexOnFace(vertex, point, normal, RADIUS, name=f"contact{i}"))
    speed = 0.1 * _unit(np.cross(up, X.rotation[:, 0]))

    def reference(t: float) -> Reference:
        """Reference at a time (s): constant speed, 10 N on each contact."""
        X_WD = _shifted(X, speed * t)
        return Reference(X_WD, np.r_[speed, 0, 0, 0], np.zeros(6), np.full(len(pairs), 10.0))

    return in_motion(name, chain, tuple(pairs), q, GAINS, reference)


def _unit(x: Array) -> Array:
    """Vector of length 1 along x."""
    return x / np.linalg.norm(x)


# --- Any number of arms around one object, with contacts, drawn at random -------------------------


class Kind(NamedTuple):
    """Kind of serial arms, with links of 1 to 3 kg, whose joints turn about or slide along their z.

    Attributes:
        joints: for each joint the placement in the joint before it: number of quarter turns about
            x, and x, y, z (m).
        tip: (3,) position of the tip in the last joint (m).
        q: mean joint positions (rad, m).
        spread: largest deviations of drawn positions from these (rad, m).
        sliding: index of the joint that slides; None: all turn.
    """

    joints: Sequence[tuple[float, ...]]
    tip: tuple[float, float, float]
    q: tuple[float, ...]
    spread: tuple[float, ...]
    sliding: int | None = None

    def draw(self, rng: np.random.Generator) -> tuple[pin.Model, Array]:
        """Draw an arm, with lengths varied by up to a tenth, and its joint positions (n,).

        Args:
            rng: generator of random numbers.
        """
        model = pin.Model()
        last = 0
        for i, (quarters, *p) in enumerate(self.joints):
            joint = pin.JointModelPZ() if i == self.sliding else pin.JointModelRZ()
            place = _at(*(rng.uniform(0.9, 1.1) * np.array(p)), roll=quarters * np.pi / 2)
            last = model.addJoint(last, joint, place, f"joint{i}")
            body = pin.Inertia(rng.uniform(1.0, 3.0), rng.uniform(-0.1, 0.1, 3), 0.02 * np.eye(3))
            model.appendBodyToJoint(last, body, pin.SE3.Identity())
        model.upperEffortLimit[:] = 1e4
        for name, point in {"wrist": (0.0, 0.0, 0.0), "tip": self.tip}.items():
            model.addFrame(pin.Frame(name, last, 0, _at(*point), pin.FrameType.OP_FRAME))
        return (model, np.array(self.q) + self.spread * rng.uniform(-1.0, 1.0, len(self.q)))


_REACH = (0, 0.325, 0, 0)
KINDS = {
    "planar": Kind([(0, 0, 0, 0), _REACH, _REACH], (0.325, 0, 0), (0, 1.4, 1.4), (3, 0.4, 0.4)),
    "scara": Kind(
        [(0, 0, 0, 0.4), _REACH, _REACH, (0, 0, 0, -0.2)],
        (0.05, 0, -0.1),
        (0, 1.3, -0.1, 0),
        (3, 0.7, 0, 3),
        sliding=2,
    ),
    "ur5": Kind(
        [
            (0, 0, 0, 0.089),
            (1, 0, 0, 0),
            (0, 0.425, 0, 0),
            (0, 0.392, 0, 0.109),
            (1, 0, -0.095, 0),
            (-1, 0, 0.082, 0),
        ],
        (0, 0, 0.12),
        (0, -1.2, 1.4, -1, -1.5, 0.3),
        (0.3,) * 6,
    ),
}
BODY = pin.Inertia(4.0, np.array([0.01, -0.02, 0.015]), np.diag([0.09, 0.11, 0.14]))


class RandomRig:
    """Random arms of some kinds around an object that they hold at rest.

    Postures are drawn, and the bases placed so that the hands reach the object. Planar arms turn in
    the horizontal plane and SCARAs stand upright, so that several of a kind permit the same
    motions.

    Attributes:
        chain: arms and object.
        q: (n,) joint positions (rad, m).
        X_WO: pose of the object.
    """

    X_WO = _at(z=0.6)

    def __init__(self, kinds: Sequence[str], rng: np.random.Generator) -> None:
        """Draw the arms, and place them around the object.

        Args:
            kinds: names in `KINDS`, one for each arm.
            rng: generator of random numbers.
        """
        arms = []
        grasps = []
        positions = []
        for i, kind in enumerate(kinds):
            model, q = KINDS[kind].draw(rng)
            angle = 2.0 * np.pi * i / len(kinds)
            grip = 0.2 * np.array([np.cos(angle), np.sin(angle)])
            X_OT = _at(*grip, yaw=rng.uniform(-3.0, 3.0))
            data = model.createData()
            pin.framesForwardKinematics(model, data, q)
            base = self.X_WO * X_OT * data.oMf[model.getFrameId("tip")].inverse()
            name = f"arm{i}"
            arm = osc.Arm.from_urdf(model, name=name, tip="tip", base=base, wrist_sensor="wrist")
            arms.append(arm)
            grasps.append(X_OT.inverse())
            positions.append(q)
        self.chain = ClosedChain(arms, grasps, osc.RigidObject(BODY))
        self.q = np.concatenate(positions)

    def case(self, name: str, pairs: Sequence[osc.ContactPair]) -> TickCase:
        """Make a case at rest with a desired force of 1 N at each contact, and no force ceilings.

        Wrists read zero although they bear the object, so ceilings of forces would stop the arms.

        Args:
            name: name of the case.
            pairs: contacts.
        """
        still = np.zeros(6)
        count = sum(pair.contact(self.X_WO, still).r for pair in pairs)
        wrenches = np.zeros((len(self.chain.arms), 6))
        measurement = Measurement(self.q, np.zeros_like(self.q), wrenches)
        reference = Reference(self.X_WO, still, still, np.full(count, 1.0))
        safety = SafetySettings(contact_ceiling=np.inf, wrist_ceiling=np.inf)
        return TickCase(
            name,
            self.chain,
            tuple(pairs),
            GAINS,
            self.q,
            measurement,
            reference,
            safety=safety,
        )


def faces_of(
    rig: RandomRig, contacts: int, rank: int, rng: np.random.Generator
) -> list[VertexOnFace]:
    """Make contacts of vertices with faces, of whose columns of N `rank` are independent.

    Faces beyond the first `rank` are copies of these, moved along their lines of force.

    Args:
        rig: arms and object.
        contacts: number of contacts.
        rank: rank of N, at most the number of contacts and the dimension of the object's motions.
        rng: generator of random numbers.
    """
    pairs: list[VertexOnFace] = []
    for i in range(contacts):
        vertex = rng.uniform(-0.3, 0.3, 3)
        normal = rng.normal(size=3)
        if i >= rank:
            normal = pairs[i % rank].normal
            back = rig.X_WO.rotation.T @ normal
            vertex = pairs[i % rank].vertex - 0.02 * (i // rank) * back
        pairs.append(VertexOnFace(vertex, rig.X_WO.act(vertex), normal, name=f"face{i}"))
    return pairs


# --- Rigs near their limits or with further parts of the law, and many rigs at once ---------------

ROWS = 4096  #: number of rows of a batch
NEAR_STRAIGHT = 0.217  #: m beyond the packaged pose, so that elbows are 0.13 rad from straight
TOO_MUCH = 1.25  #: largest commanded torque of a motor, as a multiple of its limit


class OwnFace(VertexOnFace):
    """Pair as a user writes it: N and n_γ are computed by Python in every tick."""

    def contact(self, *args, **kwargs):  # type: ignore[no-untyped-def]
        """Contact of a vertex on a face; an override in Python, which the law therefore calls."""
        return super().contact(*args, **kwargs)


def near_singular() -> TickCase:
    """Case of the rod rig with both elbows 0.13 rad from straight: motion commands are reduced."""
    rig, pairs = rod_rig()
    shift = np.array([0.0, NEAR_STRAIGHT, 0.0])
    X = object_pose(rig.chain, rig.q_contact)
    q = close(rig.chain, reach(rig.chain, rig.q_contact, _shifted(X, shift)))
    moved = tuple(replace(pair, point=pair.point + shift) for pair in pairs)

    def reference(t: float) -> Reference:
        """Reference of the scenario at a time (s), moved as the faces are."""
        at = rig.references.at(t)
        return replace(at, X_WD=_shifted(at.X_WD, shift))

    return in_motion("near_singular", rig.chain, moved, q, rig.gains, reference, Status.DEGRADED)


def _shifted(X: pin.SE3, shift: Array) -> pin.SE3:
    """Pose X moved by a shift (3,) in world axes (m)."""
    return pin.SE3(X.rotation, X.translation + shift)


def saturated() -> TickCase:
    """Case of the rod rig with motors too weak for the commands: a quadratic program per tick."""
    case = two_contact_rod()
    tau = case.controller().tick(case.measurement, case.reference)
    chain = ClosedChain(case.chain.arms, case.chain.grasps, case.chain.payload)
    chain.tau_max = chain.tau_max * (np.abs(tau) / chain.tau_max).max() / TOO_MUCH
    return replace(case, name="saturated", chain=chain, status=Status.SATURATED)


def three_arms() -> TickCase:
    """Case of three arms like a UR5, two contacts, a commanded force between each two grasps."""
    rng = np.random.default_rng(0)
    rig = RandomRig(["ur5"] * 3, rng)
    case = rig.case("three_arms", faces_of(rig, 2, 2, rng))
    squeezed = replace(case.reference, squeeze_d=np.array([10.0, 5.0, 8.0]))
    return replace(case, reference=squeezed)


def contact_phases() -> TickCase:
    """Case of the rod rig with contact phases, in which both contacts are closed."""
    return replace(two_contact_rod(), name="contact_phases", life=PhaseSettings())


def own_pair() -> TickCase:
    """Case of the rod rig, one of whose two contacts is a pair written in Python."""
    case = two_contact_rod()
    first, second = case.pairs
    own = OwnFace(first.vertex, first.point, first.normal, first.radius, name=first.name)
    return replace(case, name="own_pair", pairs=(own, second))


def vertex_on_plane(X_WO, V_O, X_WE, V_E, given, *out):  # type: ignore[no-untyped-def]
    """Fill N, n_γ, gap and point of a vertex of the object on a plane at rest.

    It has the arguments of the functions of `osc.CompiledPair`; poses X_WE and twists V_E of the
    touched body do not matter.

    Args:
        X_WO: (4, 4) pose of the object.
        V_O: (6,) twist of the object at O.
        X_WE, V_E: pose and twist of the touched body, not used.
        given: vertex in the object (3; m), unit vector into the plane (3), and coordinate of the
            plane along this vector, from the origin of the world (m).
        *out: N (6, 1), n_γ (1,), gaps (1,) and points (3, 1), filled.
    """
    N, n_gamma, gaps, points = out
    p = X_WO[:3, :3].copy() @ given[:3]
    n = given[3:6]
    p_dot = V_O[:3] + np.cross(V_O[3:], p)
    N[:3, 0] = n
    N[3:, 0] = np.cross(p, n)
    n_gamma[0] = -(n * np.cross(V_O[3:], p_dot)).sum()
    points[:, 0] = X_WO[:3, 3] + p
    gaps[0] = given[6] - (n * points[:, 0]).sum()


def compiled_pair() -> TickCase:
    """Case of the rod rig, one of whose two contacts is a function that numba compiles."""
    case = two_contact_rod()
    first, second = case.pairs
    n = -first.normal
    geometry = [*first.vertex, *n, n @ first.point - first.radius]
    own = osc.CompiledPair(vertex_on_plane, geometry, pushes=True, name=first.name)
    return replace(case, name="compiled_pair", pairs=(own, second))


KNOWN = 12  #: number of known contacts of `two_of_twelve`


def two_of_twelve() -> TickCase:
    """Case `two_pandas` with ten more known contacts, which are not active."""
    case = two_pandas()
    first, second = (pair for pair in case.pairs if isinstance(pair, VertexOnFace))
    others = []
    for k, along in enumerate(np.linspace(-0.25, 0.25, KNOWN - 2)):
        vertex = np.array([along, 0.0, 0.0])
        point = case.reference.X_WD.act(vertex) - np.array([0.0, 0.0, 0.1])
        up = np.array([0.0, 0.0, 1.0])
        others.append(VertexOnFace(vertex, point, up, RADIUS, name=f"other{k}"))
    active = np.arange(KNOWN) < 2
    forces = np.where(active, case.reference.alpha_d[0], 0.0)
    reference = replace(case.reference, alpha_d=forces, active=active.astype(float))
    return replace(case, name="two_of_twelve", pairs=(first, second, *others), reference=reference)


SPECIAL_CASES: dict[str, Callable[[], TickCase]] = {
    "near_singular": near_singular,
    "saturated": saturated,
    "three_arms": three_arms,
    "contact_phases": contact_phases,
    "two_of_twelve": two_of_twelve,
    "own_pair": own_pair,
    "compiled_pair": compiled_pair,
}


#: Standard deviations of a batch's inputs from those of a single tick, by name (SI units).
SPREADS = {"q": 1e-3, "v": 1e-3, "wrenches": 0.1, "V_D": 1e-3, "A_D": 0.0, "alpha_d": 0.1}


@dataclass
class BatchCase:
    """Batch of one rig, each row of it at a random state near that of a case.

    Attributes:
        case: rig at one instant.
        rows: number of rows.
        threads: number of threads.
        inputs: arguments of `BatchController.tick` by name.
    """

    case: TickCase
    rows: int
    threads: int

    def __post_init__(self) -> None:
        """Draw the states."""
        rng = np.random.default_rng(0)
        given = vars(self.case.measurement) | vars(self.case.reference)
        self.inputs = {}
        for name, spread in SPREADS.items():
            x = np.asarray(given[name], float)
            self.inputs[name] = x + spread * rng.normal(size=(self.rows, *x.shape))
        self.inputs["X_WD"] = np.tile(given["X_WD"].homogeneous, (self.rows, 1, 1))
        self.inputs["squeeze_d"] = np.full(self.rows, float(given["squeeze_d"]))

    def tick(self) -> Timed:
        """Function that computes a tick of all rows, and function to be called after each.

        The second one checks the status of all rows, and resets the batch.
        """
        batch = osc.BatchController([self.case.controller()] * self.rows, self.threads)
        expected = self.case.status

        def unwind() -> None:
            """Reset the batch.

            Raises:
                InvalidInputError: a row ended with another status.
            """
            wrong = np.flatnonzero(batch.status != expected)
            if len(wrong):
                ended = Status(int(batch.status[wrong[0]])).name
                raise osc.InvalidInputError(
                    f"{self.case.name}: a timed tick ended {ended} in {len(wrong)} rows, the first "
                    f"of them {wrong[0]}, expected {expected.name}"
                )
            batch.reset()

        return (partial(batch.tick, **self.inputs), unwind)

    def floor(self) -> Callable[[], object]:
        """Function that calls `pin.computeAllTerms` for all rows, one after the other."""
        model = self.case.chain.model
        data = model.createData()

        def floor() -> None:
            """Compute the terms of all rows; results are not kept."""
            for q, v in zip(self.inputs["q"], self.inputs["v"], strict=True):
                pin.computeAllTerms(model, data, q, v)

        return floor


BATCHES: dict[str, Callable[[], BatchCase]] = {
    "batch_4096": lambda: BatchCase(one_panda(), ROWS, 1),
    "batch_4096_two_threads": lambda: BatchCase(one_panda(), ROWS, 2),
}
