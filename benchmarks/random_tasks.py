"""Random tasks on random arms with everything wrong at once, for `benchmarks.cobots`.

Seven in ten press a ball on a wall in a random posture, three in ten are packaged tasks. What is
wrong comes in groups (`GROUPS`), each a list of changes of the scenario and of the plant, so that
a task can be run without one of them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pinocchio as pin

import osc_contact as osc
from osc_contact import robots
from osc_contact.contacts.pairs.pair import triad
from osc_contact.errors import InvalidInputError
from osc_contact.interface import Measurement
from osc_contact.lab.plants.mujoco import MujocoPlant
from osc_contact.lab.rig.hardware import torque_loop
from osc_contact.lab.rig.rig import PLANTS, Rig, build_chain, build_rig
from osc_contact.lab.runs.poses import BALL_M, LENGTH_M, arm_of, pose_text
from osc_contact.lab.scenarios.loader import parse_scenario
from osc_contact.robots.model import position_limits
from osc_contact.spatial import Array, columns_of

Changes = list[str]

#: Robot → the frame that carries the ball.
TIPS = {
    "panda": "panda_hand_tcp",
    "ur3_robot": "tool0",
    "ur5": "tool0",
    "ur10": "tool0",
    "xarm7": "link7",
    "z1": "gripperStator",
    "kinova": "j2s6s200_end_effector",
}
PACKAGED = (
    "panda_edge",
    "ur5_wipe",
    "three_arm_plate",
    "two_contact_rod",
    "dual_panda_rod",
    "scara_peg",
)
BALLS = 0.7  #: share of the tasks that are a ball on a wall
RATES = (250, 500, 1000, 2000, 4000)  #: Hz, of the controller; the plant's steps are 0.25 ms
DURATION = 8.0  #: s
GROUPS = ("joints", "flexible", "encoder", "wrist", "masses", "face", "friction", "wall")
NAME = "random_task"  #: of the plant in the register

#: A posture is sound where every joint is this share of its range (at most of a turn) away from
#: its ends, the tip can move in every direction with this least singular value of its Jacobian
#: (rotations on a lever of 0.2 m), motors bear this share of their limits, and the tip is above
#: the floor (m).
_MARGIN = 0.08
_LEAST = 0.08
_LEVER = 0.2
_LOAD = 0.6
_FLOOR = 0.1
_CART_KG = 0.2


@dataclass(frozen=True)
class Errors:
    """Errors of the plant of a task that its scenario cannot state.

    Attributes:
        stribeck: whether joint friction falls to 60 % as a joint moves (0.03 rad/s).
        gravity: (2,) how far gravity leans from the vertical, in x and y (rad).
        drift: (6,) of every wrist's reading (N/s, N m/s).
        told: whether the controller is given the motion of touched bodies.
    """

    stribeck: bool = False
    gravity: tuple[float, float] = (0.0, 0.0)
    drift: tuple[float, ...] = (0.0,) * 6
    told: bool = True


@dataclass(frozen=True)
class RandomTask:
    """One task, and what is wrong in it.

    Attributes:
        seed, number: it is drawn from these alone.
        name: name of the arm or scenario.
        scenario: text of one, or the name of a packaged one.
        changes: overrides of the scenario, beside those of `wrong`.
        wrong: group → changes.
        errors: errors of the plant.
        words: drawn properties in words, by name.
    """

    seed: int
    number: int
    name: str
    scenario: str
    changes: Changes
    wrong: dict[str, Changes]
    errors: Errors
    words: dict[str, str] = field(default_factory=dict)

    def without(self, group: str) -> RandomTask:
        """A copy of this task with one group of errors left out."""
        errors = self.errors
        if group == "joints":
            errors = replace(errors, stribeck=False)
        elif group == "wrist":
            errors = replace(errors, drift=(0.0,) * 6)
        elif group == "masses":
            errors = replace(errors, gravity=(0.0, 0.0))
        wrong = {name: changes for name, changes in self.wrong.items() if name != group}
        return replace(self, wrong=wrong, errors=errors)

    def load(self) -> osc.Scenario:
        """The scenario with everything that is wrong; its plant enters the register."""
        # at run time: importing this module leaves the register of plants as it is
        osc.register_plant(NAME)(self._plant)
        changes = [*self.changes, f"plant.type={NAME}"]
        for group in self.wrong.values():
            changes += group
        return _loaded(self.scenario, changes)

    def _plant(self, rig: Rig, seed: int) -> Any:
        return erring_plant(rig, seed, self.errors)


def _loaded(scenario: str, changes: Sequence[str]) -> osc.Scenario:
    if "\n" not in scenario:
        return osc.load_scenario(scenario, list(changes))
    return parse_scenario(scenario, None, list(changes))


def erring_plant(rig: Rig, seed: int, errors: Errors) -> Any:
    """MuJoCo with falling joint friction, leaning gravity and drifting wrists.

    Args:
        rig, seed: as of `register_plant`.
        errors: what it does.
    """
    plant: Any = PLANTS["mujoco"](rig, seed)
    lean = pin.exp3(np.array([*errors.gravity, 0.0]))
    plant.model.opt.gravity[:] = lean @ plant.model.opt.gravity
    stiction = plant.model.dof_frictionloss.copy()
    drift = np.array(errors.drift)

    def command(tau: Array, duration: float) -> None:
        if errors.stribeck:
            falling = 0.6 + 0.4 * np.exp(-((plant.data.qvel / 0.03) ** 2))
            plant.model.dof_frictionloss[:] = falling * stiction
        MujocoPlant.command(plant, tau, duration)

    def measure() -> Measurement:
        read = MujocoPlant.measure(plant)
        touched = read.touched if errors.told else None
        return replace(read, wrenches=read.wrenches + drift * plant.time, touched=touched)

    plant.command = command
    plant.measure = measure
    return plant


# --- Draws ----------------------------------------------------------------------------------------


def draw(seed: int, number: int) -> RandomTask:
    """A task, the same for the same numbers."""
    rng = np.random.default_rng([seed, number])
    if rng.random() < BALLS:
        name = str(rng.choice(list(TIPS)))
        scenario, words = _ball(name, rng)
    else:
        name = str(rng.choice(PACKAGED))
        scenario, words = name, {}
    rate = int(rng.choice(RATES))
    words["rate"] = f"{rate} Hz"
    changes = [
        "gains={}",
        "tare={}",
        f"duration={DURATION}",
        f"control={{rate: {rate}}}",
        "plant={type: mujoco, step: 0.25 ms}",
    ]
    chain = build_chain(_loaded(scenario, changes))
    wrong: dict[str, Changes] = {}
    wrong["joints"], rotors = _joints(chain, rng, words)
    wrong["encoder"] = _encoder(rate, rng, words)
    wrong["wrist"], drift = _wrist(rng, words)
    wrong["masses"], gravity = _masses(rng)
    wrong["face"] = _face(rng, words)
    mu = rng.uniform(0.0, 0.3)
    words["mu"] = f"{mu:.2f}"
    wrong["friction"] = [f"plant.friction={mu}"]
    told = True
    stiffness = 10.0 ** rng.uniform(4.0, np.log10(3e5))
    if rng.random() < 0.75 and name in TIPS:
        wrong["wall"] = spring_wall(_loaded(scenario, changes), stiffness)
        words["wall"] = f"{1e-3 * stiffness:.0f} kN/m"
        told = False
    frequency = rng.uniform(12.0, 40.0)
    loop = rng.random() < 0.5
    wrong["joints"] += [f"arms.{arm.name}.armature={list(own)}" for arm, own in rotors]
    if rng.random() < 0.25:  # after the rotors, which are behind its springs
        wrong["flexible"] = _flexible(chain, rotors, frequency)
        if loop:
            without = [*changes, *wrong["joints"], *wrong["flexible"]]
            wrong["flexible"].append(_torque_loop(scenario, without))
        words["flexible"] = f"{frequency:.0f} Hz{' with torque loop' if loop else ''}"
    errors = Errors(True, gravity, drift, told)
    return RandomTask(seed, number, name, scenario, changes, wrong, errors, words)


def _listed(values: Array) -> list[float]:
    return [round(float(x), 6) for x in values]


def _limits(arm: osc.Arm) -> Array:
    """Torque limits of an arm's joints, 0 of passive ones."""
    limits = np.where(np.isfinite(arm.model.effortLimit), arm.model.effortLimit, 0.0)
    names = list(arm.model.names)[1:]
    return np.where([name in arm.passive_joints for name in names], 0.0, limits)


def _joints(
    chain: osc.ClosedChain, rng: np.random.Generator, words: dict[str, str]
) -> tuple[Changes, list[tuple[osc.Arm, list[float]]]]:
    """Friction, ripple and what is known of them; the rotors of each arm."""
    coulomb, viscous, rotor = rng.uniform([0.003, 0.003, 1e-3], [0.02, 0.02, 4e-3])
    known = rng.uniform(0.5, 1.5) if rng.random() < 0.5 else 0.0
    words["Coulomb"] = f"{100 * coulomb:.1f} %"
    words["known"] = f"x {known:.2f}" if known else "no"
    changes = [
        f"plant.motors={{ripple: {rng.uniform(5e-4, 3e-3)}}}",
        f"model_error.joint_friction={known}",
        f"model_error.armature={known}",
    ]
    rotors = []
    for arm in chain.arms:
        limits = _limits(arm)
        changes.append(f"arms.{arm.name}.friction={_listed(coulomb * limits)}")
        changes.append(f"arms.{arm.name}.damping={_listed(viscous * limits)}")
        rotors.append((arm, _listed(rotor * limits)))
    return changes, rotors


def _flexible(
    chain: osc.ClosedChain,
    rotors: list[tuple[osc.Arm, list[float]]],
    frequency: float,
) -> Changes:
    """Springs in the joints, whose rotors are behind them."""
    inertia = {arm.name: [x for x in own if x > 0.0] for arm, own in rotors}
    springs = f"frequency: {frequency}, motor_inertia: {inertia}"
    changes = [f"arms.{arm.name}.armature=0" for arm in chain.arms]
    changes.append(f"plant.flexible_joints={{{springs}}}".replace("'", ""))
    return changes


def _torque_loop(scenario: str, changes: Changes) -> str:
    """A joint torque loop of the largest gain, 60 or a half, a quarter, … of it, that is stable."""
    loops = [f"control.joint_torque={{rate: 4 kHz, gain: {60.0 / 2**k}}}" for k in range(8)]
    rig = build_rig(_loaded(scenario, [*changes, loops[0]]))
    for loop in loops:
        with suppress(InvalidInputError):
            torque_loop(_loaded(scenario, [*changes, loop]), rig.chain, rig.springs)
            return loop
    return loops[-1]


def _encoder(rate: int, rng: np.random.Generator, words: dict[str, str]) -> Changes:
    """A step of a turn over 2^bits, noise of half a step; sliding joints as of half a metre."""
    bits = int(rng.integers(16, 21))
    words["encoder"] = f"{bits} bit"
    turn, travel = 2.0 * np.pi / 2**bits, 0.5 / 2**bits
    angle = f"{{resolution: {turn}, noise: {0.5 * turn}}}"
    length = f"{{resolution: {travel}, noise: {0.5 * travel}}}"
    return [f"sensors.encoder={{rate: {rate}, angle: {angle}, length: {length}}}"]


def _wrist(rng: np.random.Generator, words: dict[str, str]) -> tuple[Changes, tuple[float, ...]]:
    rate = int(rng.choice([500, 1000]))
    noise, delay, bias = rng.uniform([0.1, 1e-3, 0.0], [0.5, 5e-3, 1.0])
    direction = rng.normal(size=6) * [1, 1, 1, 0.02, 0.02, 0.02]
    drift = rng.uniform(0.0, 1.0) / 60.0 * direction / np.linalg.norm(direction[:3])
    words["wrist"] = f"{noise:.2f} N, {1e3 * delay:.1f} ms"
    force = f"{{noise: {noise}, bias: {bias}}}"
    torque = f"{{noise: {0.02 * noise}, bias: {0.02 * bias}}}"
    wrist = f"{{rate: {rate}, delay: {delay}, force: {force}, torque: {torque}}}"
    return [f"sensors.wrist={wrist}"], tuple(_listed(drift))


def _masses(rng: np.random.Generator) -> tuple[Changes, tuple[float, float]]:
    arm, held, hidden = rng.uniform([0.95, 0.95, 0.0], [1.05, 1.05, 0.1])
    about, lean = rng.uniform(0.0, [2.0 * np.pi, np.radians(0.5)])
    changes = [
        f"model_error.arm_mass={arm}",
        f"model_error.object_mass={held}",
        f"model_error.hidden_mass={hidden}",
    ]
    return changes, (float(lean * np.cos(about)), float(lean * np.sin(about)))


def _face(rng: np.random.Generator, words: dict[str, str]) -> Changes:
    tilt, about, offset = rng.uniform([0.0, 0.0, -3.0], [3.0, 360.0, 3.0])
    words["face"] = f"{tilt:.1f} deg, {offset:+.1f} mm"
    return [
        f"model_error.face_tilt={tilt} deg",
        f"model_error.face_tilt_about={about} deg",
        f"model_error.face_offset={offset} mm",
    ]


def spring_wall(scenario: osc.Scenario, stiffness: float) -> Changes:
    """A cart on a spring along the wall's normal, which bears its weight; nothing of it is told."""
    contact: Any = scenario.contacts[0]
    normal = np.array(contact.face.normal)
    preload = 9.81 * _CART_KG * normal[2]
    cart = (
        f"{{type: cart, direction: {_listed(normal)}, mass: {_CART_KG}, stiffness: {stiffness}, "
        f"preload: {preload}}}"
    )
    return ["contacts.ball.face.motion=" + cart, "model_error.environment=ignored"]


# --- A ball on a wall -----------------------------------------------------------------------------


def _ball(robot: str, rng: np.random.Generator) -> tuple[str, dict[str, str]]:
    """Text of a scenario, and what was drawn."""
    arm = arm_of(robot, TIPS[robot])
    force = rng.uniform(5.0, 30.0)
    q = next(_sound_postures(arm, force, rng))
    data = arm.model.createData()
    pin.forwardKinematics(arm.model, data, q)
    X = pin.updateFramePlacement(arm.model, data, robots.frame_id(arm.model, arm.tip))
    axis = X.rotation[:, 2]
    centre = X.translation + LENGTH_M * axis
    side = triad(axis)[:, :2] @ _unit(rng.normal(size=2))
    away = np.radians(rng.uniform(0.0, 40.0))
    normal = -(np.cos(away) * axis + np.sin(away) * side)
    point = centre - BALL_M * normal
    size, frequency = rng.uniform([0.01, 0.1], [0.05, 0.6])
    size = min(size, 0.1 / (2.0 * np.pi * frequency))
    circle = rng.random() < 0.5
    turned = triad(normal)[:, :2] @ _turn(rng.uniform(0.0, 2.0 * np.pi))
    motion = [
        f"{{kind: linear, direction: {_listed(along)}, signals: [{{type: sine, ramp: 1 s, "
        f"amplitude: {size}, frequency: {frequency}, phase: {phase} deg}}]}}"
        for along, phase in zip(turned.T[: 1 + circle], (0, 90), strict=False)
    ]
    step = rng.choice([-0.3, 0.3]) * force
    swing, hertz = rng.uniform([0.1, 0.1], [0.3, 0.6])
    words = {
        "force": f"{force:.0f} N",
        "path": f"{'circle' if circle else 'line'} {1e3 * size:.0f} mm {frequency:.2f} Hz",
        "off axis": f"{np.degrees(away):.0f} deg",
    }
    text = f"""\
name: {arm.name}_on_a_wall
description: presses a ball on a wall and slides it
arms:
  - name: {arm.name}
    urdf: example-robot-data:{robot}
    tip: {arm.tip}
    wrist_sensor: {arm.tip}
    posture: {_listed(q)}
object: {{urdf: stylus.urdf}}
grasps:
  {arm.name}: {pose_text(pin.SE3.Identity())}
contacts:
  - name: ball
    type: vertex_on_face
    vertex: [0, 0, {LENGTH_M}]
    radius: {BALL_M}
    face: {{urdf: face.urdf, point: {_listed(point)}, normal: {_listed(normal)}}}
force:
  ball:
    - {{type: constant, value: {force}}}
    - {{type: sine, amplitude: {swing * force}, frequency: {hertz}, ramp: 1 s}}
    - {{type: step, value: {step}, start: 4 s}}
motion: [{", ".join(motion)}]
control: {{rate: 1 kHz}}
plant: {{type: mujoco, step: 0.25 ms}}
duration: {DURATION}
"""
    return text, words


def _unit(x: Array) -> Array:
    return x / np.linalg.norm(x)


def _turn(angle: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s], [s, c]])


def _sound_postures(arm: osc.Arm, force: float, rng: np.random.Generator) -> Iterator[Array]:
    """Random postures away from ends, singular ones and the floor, which the motors bear."""
    model = arm.model
    data = model.createData()
    tip = robots.frame_id(model, arm.tip)
    low, high = position_limits(model)
    ranges = np.minimum(high - low, 2.0 * np.pi)
    for q in robots.random_configurations(model, 100_000, int(rng.integers(1 << 31))):
        turned = (q + np.pi) % (2.0 * np.pi) - np.pi  # angles between ∓π, where limits allow it
        q = np.where((turned >= low) & (turned <= high), turned, q)
        room = np.minimum(q - low, high - q) / ranges
        if room.min() < _MARGIN:
            continue
        J = columns_of(
            pin.computeFrameJacobian(model, data, q, tip, pin.LOCAL_WORLD_ALIGNED)
        ).copy()
        X = pin.updateFramePlacement(model, data, tip)
        axis = X.rotation[:, 2]
        reach = X.translation + (LENGTH_M + 2.0 * BALL_M) * axis
        load = pin.computeGeneralizedGravity(model, data, q) - J[:3].T @ (force * axis)
        J[3:] *= _LEVER
        sizes = np.linalg.svd(J, compute_uv=False)
        strained = (np.abs(load) > _LOAD * model.effortLimit).any()
        if min(reach[2], X.translation[2]) > _FLOOR and sizes[5] > _LEAST and not strained:
            yield q
