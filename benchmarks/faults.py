"""Kinds of faults: of encoders, speeds, wrists, packets, references, motors and the world."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, NamedTuple

import mujoco
import numpy as np
import pinocchio as pin

import osc_contact as osc
from osc_contact.control.status import SafetyState
from osc_contact.interface import Measurement, Reference, Stamps
from osc_contact.lab.plants.mujoco import MujocoPlant

RUN, DEGRADED, HOLD, SAFE_STOP = SafetyState
NAN = float("nan")
POST = 20e3  #: N/m, of a post that stands in the way
POST_SEEN_AFTER = 0.15  #: s, `overforce_time`
DRAG = 20.0  #: N, of a cable
HAND = (1e3, 50.0)  #: N/m and N s/m, of a person who holds an arm
TILT = np.deg2rad(5.0)  #: of gravity
AWAY = 10.0  #: m, to where faces vanish

Change = Callable[["Trial", Measurement, Reference], tuple[Measurement, Reference]]


class Fault(NamedTuple):
    """One kind of fault.

    Attributes:
        change: changes a measurement and a reference while it lasts; or None.
        lasts: s; inf: to the end.
        ends: states that a run may end in.
        limited: whether contact forces are judged: not where the reference commands a collision.
        torque: changes the torques on their way to the motors; or None.
        world: changes the simulated robot or what acts on it, before each control period; or None.
        unsound: names of the readings that it makes worthless, of `Measurement`, and "tau" where a
            motor does not give its torque: with "q" and "v", or with "tau", brakes may be
            requested; with "q" alone where speeds are estimated from positions.
        arms: least number of arms that it takes.
        stiffness: N/m, of an obstacle: forces grow with it until the arm is stopped.
        pulls: whether it moves an arm that is stopped, and at rest.
        hangs: whether the object hangs on its first arm alone then.
        mirrors: whether a contact force f reads as -f, which makes the force loop unstable.
        grows: whether a contact force may grow steadily until it is found above its ceiling.
        of_speeds: whether it changes speeds alone, which no sensor reads where they are estimated
            from positions.
    """

    change: Change | None = None
    lasts: float = np.inf
    ends: tuple[SafetyState, ...] = (RUN, DEGRADED, HOLD, SAFE_STOP)
    limited: bool = True
    torque: Callable[[Trial, np.ndarray], np.ndarray] | None = None
    world: Callable[[Trial, MujocoPlant], None] | None = None
    unsound: tuple[str, ...] = ()
    arms: int = 1
    stiffness: float = 0.0
    pulls: bool = False
    hangs: bool = False
    mirrors: bool = False
    grows: bool = False
    of_speeds: bool = False


@dataclass
class Trial:
    """One run with a fault in it.

    Attributes:
        rng: generator of the fault's random numbers.
        chain: the controller's model.
        dt: s, a control period.
        k: ticks since it began.
        kept: values that the fault remembers.
    """

    rng: np.random.Generator
    chain: osc.ClosedChain
    dt: float = 1e-3
    k: int = 0
    kept: dict[str, Any] = field(default_factory=dict)

    def first(self, name: str, value: Any) -> Any:
        """The value when the fault began."""
        return self.kept.setdefault(name, value)

    def pick(self, n: int) -> int:
        """One of n, the same all the time."""
        return int(self.first(f"pick{n}", self.rng.integers(n)))

    def direction(self) -> np.ndarray:
        """A unit vector (3,), drawn at random, the same all the time."""
        drawn = self.first("direction", self.rng.normal(size=3))
        return np.asarray(drawn / np.linalg.norm(drawn))


# --- Readings -------------------------------------------------------------------------------------


def _all(t: Trial, x: np.ndarray) -> Any:
    return ...


def _one(t: Trial, x: np.ndarray) -> Any:
    """Index of one number, the same all the time."""
    return np.unravel_index(t.pick(x.size), x.shape)


def _row(t: Trial, x: np.ndarray) -> Any:
    """Index of the wrist of one arm."""
    return t.pick(len(x))


def _motor(t: Trial, x: np.ndarray) -> Any:
    """The joint of one motor, the same all the time."""
    joints = t.chain.actuated
    return joints[t.pick(len(joints))]


def _reading(
    name: str,
    where: Callable[[Trial, np.ndarray], Any] = _all,
    gain: float = 1.0,
    offset: float = 0.0,
    drift: float = 0.0,
    gain_drift: float = 0.0,
    noise: float = 0.0,
    stuck: bool = False,
) -> Change:
    """A change of numbers of an array of the measurement.

    Args:
        name: name of the array.
        where: index of the numbers.
        gain: factor.
        offset: in its unit.
        drift: drift of the offset, per second.
        gain_drift: drift of the gain (1/s).
        noise: standard deviation.
        stuck: whether they stay as they were at the beginning.
    """

    def change(t: Trial, m: Measurement, r: Reference) -> tuple[Measurement, Reference]:
        x = np.array(getattr(m, name))
        i = where(t, x)
        seconds = t.k * t.dt
        if stuck:
            x[i] = t.first(name, x[i].copy())
        else:
            x[i] = (gain + gain_drift * seconds) * x[i] + offset + drift * seconds
            x[i] += noise * t.rng.normal(size=x[i].shape)
        changes: dict[str, Any] = {name: x}
        return (replace(m, **changes), r)

    return change


def _packet(make: Callable[[Trial, Measurement], Measurement]) -> Change:
    return lambda t, m, r: (make(t, m), r)


def _late(t: Trial, m: Measurement) -> Measurement:
    """Wrists whose clock drifts: they are later by 10 ms with each second."""
    past = t.first("past", [])
    past.append(m.wrenches)
    return replace(m, wrenches=past[-1 - round(0.01 * t.k)])


def _saturated(t: Trial, m: Measurement) -> Measurement:
    """Wrists that read 0.9 of the load at the beginning at most."""
    most = 0.9 * t.first("most", np.abs(m.wrenches))
    return replace(m, wrenches=np.clip(m.wrenches, -most, most))


def _swapped_joints(t: Trial, m: Measurement) -> Measurement:
    """Encoders and speeds of two neighbouring joints of an arm, swapped."""
    own = _motors_of(t, t.pick(len(t.chain.arms)))
    i = int(t.first("joint", t.rng.integers(len(own) - 1)))
    return _permuted(m, [own[i], own[i + 1]], [own[i + 1], own[i]])


def _swapped_speeds(t: Trial, m: Measurement) -> Measurement:
    """Speeds of two joints of an arm, swapped."""
    own = _motors_of(t, t.pick(len(t.chain.arms)))
    i, j = t.first("joints", t.rng.choice(len(own), 2, replace=False))
    return replace(m, v=_permuted(m, [own[i], own[j]], [own[j], own[i]]).v)


def _swapped_arms(t: Trial, m: Measurement) -> Measurement:
    """Encoders and speeds of two arms, swapped joint by joint."""
    both = list(zip(_motors_of(t, 0), _motors_of(t, 1), strict=False))
    first = [one for one, _ in both]
    second = [one for _, one in both]
    return _permuted(m, first + second, second + first)


def _motors_of(t: Trial, arm: int) -> list[int]:
    """Joints with motors of an arm."""
    name = t.chain.arms[arm].name
    return [int(i) for i in t.chain.actuated if t.chain.joint_names[i].startswith(f"{name}/")]


def _permuted(m: Measurement, to: list[int], of: list[int]) -> Measurement:
    """Readings of some joints in place of those of others."""
    q = np.array(m.q)
    v = np.array(m.v)
    q[to] = q[of]
    v[to] = v[of]
    return replace(m, q=q, v=v)


# --- References and motors ------------------------------------------------------------------------


def _goal(name: str, make: Callable[[Any], Any]) -> Change:
    return lambda t, m, r: (m, replace(r, **{name: make(getattr(r, name))}))


def _turned(scale: Any) -> Change:
    """A goal whose rotation, with its columns scaled, is another matrix."""

    def bad(X: pin.SE3) -> pin.SE3:
        bad = X.copy()
        bad.rotation = X.rotation * scale
        return bad

    return _goal("X_WD", bad)


def _weaken(share: float) -> Callable[[Trial, np.ndarray], np.ndarray]:
    """One motor gives a share of its command."""

    def make(t: Trial, tau: np.ndarray) -> np.ndarray:
        tau[t.pick(len(tau))] *= share
        return tau

    return make


def _delay(t: Trial, tau: np.ndarray) -> np.ndarray:
    before = t.kept.get("last", tau)
    t.kept["last"] = tau
    return before


# --- The world ------------------------------------------------------------------------------------


def _brake(t: Trial, plant: MujocoPlant) -> None:
    """The brake of a joint engages: dry friction of ten times its motor's limit."""
    motor = t.pick(len(t.chain.actuated))
    joint = plant.model.joint(t.chain.joint_names[t.chain.actuated[motor]])
    limit = t.chain.model.upperEffortLimit[t.chain.actuated[motor]]
    plant.model.dof_frictionloss[joint.dofadr] = 10.0 * limit


def _tilt_gravity(t: Trial, plant: MujocoPlant) -> None:
    """The base tilts: gravity turns about a horizontal axis."""
    usual = t.first("gravity", plant.model.opt.gravity.copy())
    angle = t.first("angle", t.rng.uniform(0.0, 2.0 * np.pi))
    axis = np.array([np.cos(angle), np.sin(angle), 0.0])
    plant.model.opt.gravity[:] = pin.exp3(TILT * axis) @ usual


def _drop(t: Trial, plant: MujocoPlant) -> None:
    """One arm lets go of the object: not the first one, on which the object hangs."""
    arm = t.chain.arms[1 + t.pick(len(t.chain.arms) - 1)].name
    for i in range(plant.model.neq):
        if plant.model.equality(i).name.startswith(f"{arm}/tie."):
            plant.data.eq_active[i] = 0


def _remove_faces(t: Trial, plant: MujocoPlant) -> None:
    """All bodies of the environment are gone."""
    if t.k == 0:
        for i in range(len(plant.faces.rails)):
            plant.model.body_pos[plant.model.body(f"face{i}/root").id] += AWAY


class _Forearm:
    """The link behind the middle joint of an arm, at its centre of mass.

    Attributes:
        p, v: (3,) position and velocity in the world (m, m/s).
    """

    def __init__(self, t: Trial, plant: MujocoPlant) -> None:
        name = t.chain.arms[t.pick(len(t.chain.arms))].name
        joints = [one for one in t.chain.joint_names if one.startswith(f"{name}/")]
        self._plant = plant
        self._body = int(plant.model.joint(joints[(len(joints) - 1) // 2]).bodyid[0])
        self.p = plant.data.xipos[self._body].copy()
        velocity = np.zeros(6)
        kind = mujoco.mjtObj.mjOBJ_BODY
        mujoco.mj_objectVelocity(plant.model, plant.data, kind, self._body, velocity, 0)
        self.v = velocity[3:]

    def push(self, force: np.ndarray) -> None:
        """Apply a force (3,) in N over the next control period, in place of the one before."""
        plant = self._plant
        push = np.zeros(plant.model.nv)
        mujoco.mj_applyFT(plant.model, plant.data, force, np.zeros(3), self.p, self._body, push)
        joints = [plant.model.joint(name).dofadr[0] for name in plant.chain.joint_names]
        plant.data.qfrc_applied[joints] = push[joints]


def _post(t: Trial, plant: MujocoPlant) -> None:
    """A post that the forearm touches when the fault begins, in the direction of its motion.

    `kept["speed"]` is the largest speed at which the forearm has moved into it (m/s): an arm at
    rest meets it later.
    """
    arm = _Forearm(t, plant)
    speed = float(np.linalg.norm(arm.v))
    n = t.first("into", arm.v / speed if speed > 1e-3 else t.direction())
    depth = float(n @ (arm.p - t.first("post", arm.p)))
    into = float(n @ arm.v) if depth >= 0.0 else 0.0
    t.kept["speed"] = max(t.kept.get("speed", 0.0), into)
    arm.push(-max(0.0, POST * depth + 0.002 * POST * float(n @ arm.v)) * n * (depth > 0.0))


def _cable(t: Trial, plant: MujocoPlant) -> None:
    """A cable that drags at the forearm with a constant force."""
    _Forearm(t, plant).push(DRAG * t.direction())


def _hand(t: Trial, plant: MujocoPlant) -> None:
    """A person who holds the forearm where it was."""
    arm = _Forearm(t, plant)
    k, d = HAND
    arm.push(-k * (arm.p - t.first("hand", arm.p)) - d * arm.v)


_angles, _speeds, _wrists = (partial(_reading, name) for name in ("q", "v", "wrenches"))
_STOPS = (SAFE_STOP,)
_ENCODER = ("q",)
_JOINTS = ("q", "v")
_MOTOR = ("tau",)
_ON = (RUN, DEGRADED)
_TICK = 1e-9  #: of a fault that lasts one tick
_NO_WRENCH = _packet(lambda t, m: replace(m, wrenches=NAN * m.wrenches, wrench_valid=False))
_JUMP = np.array([0.05, 0.0, 0.0])

FAULTS: dict[str, Fault] = {
    "no fault": Fault(None, 0.0, _ON),
    # encoders
    "encoder NaN once": Fault(_angles(_one, NAN), _TICK, _ON),
    "encoder NaN for ever": Fault(_angles(_one, NAN), ends=_STOPS, unsound=_ENCODER),
    "encoders NaN, 15 ticks": Fault(_angles(gain=NAN), 0.014, _ON),
    "encoder spike of 1 rad, one tick": Fault(_angles(_motor, offset=1.0), _TICK, _ON),
    "encoder jumps by 1 rad": Fault(_angles(_motor, offset=1.0), ends=_STOPS, unsound=_ENCODER),
    "encoder 1e200": Fault(_angles(_motor, 0.0, 1e200), ends=_STOPS, unsound=_ENCODER),
    "encoder stuck": Fault(_angles(_motor, stuck=True), unsound=_ENCODER),
    "encoders stuck, speeds too": Fault(
        _packet(lambda t, m: replace(m, q=t.first("q", m.q), v=t.first("v", m.v))),
        ends=_STOPS,
        unsound=_JOINTS,
    ),
    "encoders stuck, speeds zero": Fault(
        _packet(lambda t, m: replace(m, q=t.first("q", m.q), v=0.0 * m.v)), unsound=_JOINTS
    ),
    "encoder mirrored": Fault(_angles(_motor, -1.0), unsound=_ENCODER),
    "encoder drifts by 0.2 rad/s": Fault(_angles(_motor, drift=0.2), unsound=_ENCODER),
    "encoder offset of 1 degree": Fault(_angles(_motor, offset=np.deg2rad(1.0))),
    "joints swapped": Fault(_packet(_swapped_joints), unsound=_JOINTS),
    "speeds swapped": Fault(_packet(_swapped_speeds), of_speeds=True),
    "arms swapped": Fault(_packet(_swapped_arms), unsound=_JOINTS, arms=2),
    "encoder noise of 5 mrad": Fault(_angles(noise=5e-3)),
    # speeds
    "speed NaN once": Fault(_speeds(_one, NAN), _TICK, _ON, of_speeds=True),
    "speed inf for ever": Fault(_speeds(_one, offset=np.inf), ends=_STOPS, of_speeds=True),
    "speed spike, one tick": Fault(_speeds(_motor, 0.0, 100.0), _TICK, _ON, of_speeds=True),
    "speeds zero": Fault(_speeds(gain=0.0), of_speeds=True),
    "speeds mirrored": Fault(_speeds(gain=-1.0), of_speeds=True),
    "speed noise of 0.05 rad/s": Fault(_speeds(noise=0.05), of_speeds=True),
    # wrists
    "wrench NaN once": Fault(_wrists(_one, NAN), _TICK, _ON),
    "wrench NaN, 19 ticks": Fault(_wrists(_one, NAN), 0.018, _ON),
    "wrench NaN for ever": Fault(_wrists(_one, NAN), ends=_STOPS),
    "wrench 100 kN once": Fault(_wrists(_one, 0.0, 1e5), _TICK, _ON),
    "wrench 900 N once": Fault(_wrists(_one, 0.0, 900.0), _TICK, _ON),
    "wrench 100 kN for ever": Fault(_wrists(_one, 0.0, 1e5), ends=_STOPS),
    "wrists read zero": Fault(_wrists(gain=0.0)),
    "one wrist reads zero": Fault(_wrists(_row, 0.0)),
    "one wrist stuck": Fault(_wrists(_row, stuck=True)),
    "wrists mirrored": Fault(_wrists(gain=-1.0), mirrors=True),
    "one wrist mirrored": Fault(_wrists(_row, -1.0), mirrors=True),
    "wrist offset of 20 N": Fault(_wrists(_one, offset=20.0)),
    "wrists times 0.3": Fault(_wrists(gain=0.3)),
    "wrist gain drifts by 20 %/s": Fault(_wrists(gain_drift=0.2)),
    "wrist clock drifts by 10 ms/s": Fault(_packet(_late)),
    "wrists saturate": Fault(_packet(_saturated)),
    "wrist noise of 5 N": Fault(_wrists(noise=5.0)),
    "no wrench for 15 ticks": Fault(_NO_WRENCH, 0.014, _ON),
    "no wrench for ever": Fault(_NO_WRENCH, ends=_STOPS),
    # packets
    "packet repeats for ever": Fault(
        _packet(lambda t, m: t.first("packet", m)), ends=_STOPS, unsound=_JOINTS
    ),
    "same sequence number": Fault(
        _packet(lambda t, m: replace(m, sequence=7)), ends=_STOPS, unsound=_JOINTS
    ),
    "packets out of order": Fault(
        _packet(lambda t, m: replace(m, sequence=t.k + (3 if t.k % 2 else -3))), 0.2
    ),
    "clock stands still": Fault(
        _packet(lambda t, m: replace(m, stamps=Stamps(1.0, 1.0, 1.0, 1.0))),
        ends=_STOPS,
        unsound=_JOINTS,
    ),
    # references
    "X_WD no rotation": Fault(_turned(1.5), ends=_STOPS),
    "X_WD mirrored": Fault(_turned([1.0, 1.0, -1.0]), ends=_STOPS),
    "reference NaN once": Fault(_goal("V_D", lambda V: V * NAN), _TICK, _ON),
    "reference jumps by 5 cm": Fault(
        _goal("X_WD", lambda X: pin.SE3(X.rotation, X.translation + _JUMP)), limited=False
    ),
    "reference accelerates by 50 m/s²": Fault(
        _goal("A_D", lambda A: A + [50.0, 0, 0, 0, 0, 0]), 0.1, limited=False
    ),
    # motors
    "a motor is dead": Fault(torque=_weaken(0.0), unsound=_MOTOR),
    "a motor is weak": Fault(torque=_weaken(0.7), unsound=_MOTOR),
    "torque constant of 50 %": Fault(torque=_weaken(0.5), unsound=_MOTOR),
    "torques are late by a tick": Fault(torque=_delay),
    # the world
    "a brake engages": Fault(world=_brake, grows=True),
    "gravity tilts by 5 degrees": Fault(world=_tilt_gravity),
    "a grasp lets go": Fault(world=_drop, arms=2, hangs=True),
    "faces vanish": Fault(world=_remove_faces),
    "a post at the forearm": Fault(world=_post, stiffness=POST),
    "a cable drags at the forearm": Fault(world=_cable, pulls=True),
    "a person holds the forearm": Fault(world=_hand, pulls=True),
}
