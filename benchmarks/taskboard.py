"""NIST's assembly task board 1 in gym-taskboard: pegs held by fingers, holes that are elsewhere.

    make worlds    (or, in its environment: python -m benchmarks.taskboard [--seeds N] [--parts …])

A Panda holds a peg of 50 mm between its fingers, 3 mm above the board; its hole is beside the place
that the controllers are given, in a random direction. The environment is unmodified but for a wrist
sensor, which its Panda lacks; bodies at rest sleep, an option of MuJoCo that saves nine tenths of
the time. Each episode begins with the peg between the open fingers, which then close with
the environment's force of 70 N: friction alone holds the peg. The coefficient of friction is 1
between all of them, as the plate has MuJoCo's default and the larger of two coefficients counts.
Three controllers search for the hole:

* ours, a round peg: it goes in upright if the hole is where it is believed. If the tip meets the
  face, `peg_plan` of `osc_contact.lab.tasks.pegs` follows, unchanged: the lowest point of the
  tilted tip slides under 6 N until it drops. The peg is tilted in the plane in which the flat
  fingers hold it by their faces; about the axis on which they close friction alone holds it.
  Through `MujocoArm.driven` and `SteppedLoop`, 500 times a second;
* ours, a rectangular peg: a plan with a guarded approach, a spiral of the upright peg under a
  commanded force, and an insertion that waits for forces;
* impedance: the stages of the spiral, without contacts: the reference goes as deep as the force
  needs;
* joint servos: the spiral by the environment's own actions, 20 a second, by the package's inverse
  kinematics; the goal is `DEPTH` below the face.

A peg is seated as the package judges: within 1.5 mm of the table below the board, aligned, at the
end. P_S is its `scoring.success_probability`, the probability that can be claimed with 95 %
confidence. Forces are the true sums of contact forces between the peg and all but the robot, after
each millisecond; slip is the displacement of the peg in the hand. Settings were chosen on seeds
below `FRESH`; the comparison begins with a seed that is drawn anew and printed. Verdicts are kept
in out/taskboard by the hash of the sources, so that `--first` with that seed continues where a
comparison was interrupted.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
import typer
from gym_taskboard import scene, scoring
from gym_taskboard.control import TCP, ik_action
from gym_taskboard.env import TaskBoardEnv
from rich.console import Console

import osc_contact as osc
from benchmarks.kept import ROOT, Kept
from benchmarks.measuring import side_by_side, without_log
from osc_contact.contacts.insertion import Hole, Peg, pairs_between
from osc_contact.dynamics.assembly import reach
from osc_contact.lab.tasks import pegs as tilted
from osc_contact.plan import ends, motions
from osc_contact.plan.sensed import Sensed
from osc_contact.spatial import Array
from paper.study import table_of

KEPT = ROOT / "out/taskboard"
PEGS = tuple(f"peg_{shape}_{size}" for shape in ("round", "rect") for size in (4, 8, 12, 16))
APART = ("pegs", "connectors")  #: not on the board at first: plugs would meet the hand
HAND = "panda/hand"
WRIST = "wrist"  #: site and sensors that are added to the hand
LENGTH = 0.05  #: length of the pegs (m)
GRIP = 0.015  #: distance of the fingertips from the middle of the peg, towards its top (m)
GAP = 0.003  #: distance of the peg from the board at the start (m)
PERIOD = 2e-3  #: control period (s)
LIMIT = 25.0  #: s, after which an episode ends
ACTION = 0.05  #: duration of an action of the environment (s)
FRESH = 5000  #: least seed that is drawn for a comparison
TABLE = 29e-3  #: depth of the table below the board's face (m)

PRESS = 4.0  #: force during the search (N)
SPEED = 0.01  #: speed on the spiral (m/s)
PITCH = 0.9  #: distance of neighbouring turns, as a share of the clearance
RADIUS = 2.6e-3  #: radius at which the search has failed (m)
DROP = 3e-4  #: drop of the peg, within about `RECENT`, by which the hole is found (m)
RECENT = 0.5  #: time constant of the level from which a drop counts (s)
DEEP = 26e-3  #: depth below the face from which on a peg may be seated (m)
INSERTION = 0.012  #: speed of the insertion (m/s)
DEPTH = 5e-4  #: depth of the servos' goal below the face during the search (m)
STIFFNESS = (600.0, 600.0, 600.0, 20.0, 20.0, 20.0)  #: of the impedance (N/m, N m/rad)
CEILING = 100.0  #: force at wrist and contacts above which our controller stops (N)
GAINS = osc.Gains(
    motion=osc.MotionGains(frequency=8.0, damping_ratio=1.0),
    force=osc.ForceGains(integral=4.0, damping=0.0, brake=60.0, rise=0.25),
)
DOWN = np.array([0.0, 0.0, -1.0])


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


# --- The world ------------------------------------------------------------------------------------


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
            rotation = self.hole.rotation @ _about_z(0.5 * np.pi * turns)
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


# --- The controllers ------------------------------------------------------------------------------


def _spiral(episode: Episode) -> tuple[float, float]:
    """Pitch (m) and speed (m/s) of the spiral; narrow holes are searched more slowly.

    Args:
        episode: peg and hole.
    """
    return PITCH * episode.clearance, SPEED * min(1.0, episode.clearance / 2e-4)


def _depth(now: Sensed) -> float:
    """Depth of the peg's tip below the point at which it touched the face (m)."""
    return float(DOWN @ (now.X.translation - now.passed["touch"].translation))


def dropped() -> ends.End:
    """Condition that the tip is lower than it was lately, by `DROP`.

    A peg that fingers hold creeps up in them under the force of the search, some tenths of a
    millimetre in ten seconds, so that the depth since the touch is no evidence of a hole.
    """

    def begin(now: Sensed) -> ends.Watch:
        """Begin with the present height."""
        level = float(DOWN @ now.X.translation)

        def met(now: Sensed, dt: float) -> bool:
            """Update the low-passed height, and compare the present one with it.

            Args:
                now: signals after the last tick.
                dt: control period (s).
            """
            nonlocal level
            height = float(DOWN @ now.X.translation)
            level += dt / RECENT * (height - level)
            return height - level > DROP

        return met

    return ends.End(begin, f"dropped by {1e3 * DROP:g} mm")


#: Forces and motion of an approach, and the condition that the face is touched.
Approach = tuple[dict[str, float], motions.Motion, ends.End]


def _stages(
    episode: Episode,
    start: pin.SE3,
    approach: Approach,
    inside: dict[str, float],
) -> list[osc.Stage]:
    """Stages of a plan: weigh, touch, search, insert; after a failure back to the start.

    Args:
        episode: peg and hole.
        start: pose of the peg's tip at the start.
        approach: forces and motion of the approach, and the condition that the face is touched.
            Forces and motion remain during the search.
        inside: forces of the insertion.
    """
    pressed, motion, touched = approach
    pitch, speed = _spiral(episode)
    fallen = ends.moved(GAP + 1e-3, DOWN)  # there was no face: the hole is where it is believed
    deep = ends.when(lambda now: _depth(now) > DEEP, "deep")
    seated = (deep & ends.pressed(6.0, DOWN) & ends.at_rest(2e-3, 0.05)).lasting(0.2)
    place = {"hole": lambda now: now.X * episode.hole.inverse()} if inside else {}
    search = motions.spiral(DOWN, pitch, speed, RADIUS) & motion
    stage = osc.Stage
    return [
        stage("weigh", until=ends.after(0.4), within=1.0, tare=True),
        stage("touch", pressed, motion, until=touched | fallen, within=4.0, fails="back"),
        stage(
            "search",
            pressed,
            search,
            until=dropped(),
            unless=ends.finished(),
            within=LIMIT,
            fails="back",
        ),
        stage(
            "insert",
            inside,
            motions.along([0, 0, 1], INSERTION, axes="object", yields=10.0),
            until=seated,
            within=8.0,
            fails="back",
            places=place,
            then="done",
        ),
        stage(
            "back",
            {},
            motions.along(-DOWN, 20e-3, 2.0 * GAP),
            until=ends.finished(),
            within=3.0,
            then="return",
        ),
        stage(
            "return",
            {},
            motions.to(start, 20e-3),
            until=ends.finished(),
            within=4.0,
            then="touch",
        ),
        stage("done", inside, until=ends.after(0.1), within=1.0),
    ]


def _about_z(angle: float) -> Array:
    """Rotation (3, 3) about z by an angle (rad)."""
    return np.array(pin.rpy.rpyToMatrix(0.0, 0.0, angle))


def _arm(episode: Episode, turn: float | None = None) -> osc.MujocoArm:
    """The arm with the peg, whose tip is the operational point, z out of it.

    Args:
        episode: peg in the hand.
        turn: angle of the operational frame in the hand, about the peg's axis (rad); None: that at
            which its axes are those of the hole.
    """
    model = episode.env.model
    peg = episode.peg.body_id
    angle = -0.5 * np.pi * episode.turns if turn is None else turn
    tip = pin.SE3(_about_z(angle), TCP + np.array([0.0, 0.0, GRIP + 0.5 * LENGTH]))
    middle = np.array([0.0, 0.0, -0.5 * LENGTH])
    inertia = pin.Inertia(float(model.body_mass[peg]), middle, np.diag(model.body_inertia[peg]))
    return osc.MujocoArm(
        model,
        episode.env.data,
        tip=HAND,
        tip_offset=tip,
        wrist_sensor=WRIST,
        payload=osc.RigidObject(inertia),
        name="panda",
    )


def _follow(
    episode: Episode, arm: osc.MujocoArm, controller: osc.Controller, plan: osc.Plan
) -> str:
    """Step the environment until the peg is seated, the plan has ended, or time is up.

    Args:
        episode: peg and hole.
        arm: arm of the environment.
        controller: controller of the arm.
        plan: plan that gives the references.

    Returns:
        How the plan ended.
    """
    loop = osc.SteppedLoop(controller, plan=plan)
    with loop, arm.driven(loop.step, dt=PERIOD):
        while not (plan.ended or episode.status()[1] or episode.time > LIMIT):
            episode.act()
    return f"{plan.stage.name}: {plan.reason or plan.outcome.value}"


def ours(episode: Episode) -> str:
    """Insert the peg by our controller; returns how its plan ended.

    Args:
        episode: peg in the hand.
    """
    return _ours_upright(episode) if episode.rectangular else _ours_tilted(episode)


def _ours_tilted(episode: Episode) -> str:
    """Insert a round peg by `peg_plan`, unless it goes in upright; returns how the plan ended.

    The peg's x axis, towards its lowest point, is the axis on which the fingers close.

    Args:
        episode: peg in the hand.
    """
    turn = 0.5 * np.pi
    arm = _arm(episode, turn)
    peg = Peg("round", 2.0 * episode.peg.r)
    frame = pin.SE3(_about_z(turn + 0.5 * np.pi * episode.turns), np.zeros(3))
    hole = Hole("round", 2.0 * episode.peg.hole_r, TABLE, episode.hole * frame)
    plan = osc.Plan(
        [*_upright_stages(peg, hole), *tilted.peg_plan(peg, hole).stages[1:]],
        largest=CEILING,
        tries=4,  # of which the first is upright
    )
    touch = pairs_between(peg, hole)
    return _pressed(episode, arm, plan, [touch[name] for name in plan.contacts], tilted.GAINS)


def _upright_stages(peg: Peg, hole: Hole) -> list[osc.Stage]:
    """Stages that weigh a peg, insert it if there is no face, and else tilt it beside the hole.

    Args:
        peg: round peg.
        hole: hole at its believed pose.
    """
    face = "tip on face"
    lifted = motions.along(-DOWN, 20e-3, GAP)
    tilt = motions.to(tilted.peg_start(peg, hole), 30e-3, 0.5)
    fallen = ends.moved(GAP + 1e-3, DOWN)
    deep = ends.moved(GAP + DEEP, DOWN, since="weigh")
    seated = deep & ends.pressed(6.0, DOWN) & ends.at_rest(2e-3, 0.05)
    return [
        osc.Stage("weigh", until=ends.after(0.4), within=1.0, tare=True),
        osc.Stage(
            "touch",
            {face: PRESS},
            until=fallen,
            unless=ends.made(face, lasting=0.1),
            within=4.0,
            fails="lift",
        ),
        osc.Stage(
            "enter",
            {"hole": 0.0},
            motions.along([0, 0, 1], INSERTION, axes="object", yields=10.0),
            until=seated.lasting(0.2),
            within=6.0,
            fails="lift",
            then="done",
            places={"hole": lambda now: hole.found_at(now.X)},
        ),
        osc.Stage("lift", {}, lifted, until=ends.finished(), within=3.0),
        osc.Stage("tilt", {}, tilt, until=ends.finished(), within=8.0),
    ]


def _ours_upright(episode: Episode) -> str:
    """Insert a rectangular peg after a spiral; returns how the plan ended.

    Args:
        episode: peg in the hand.
    """
    arm = _arm(episode)
    q = arm.measure().q
    hole = episode.hole
    face = osc.VertexOnFace([0, 0, 0], hole.translation, -DOWN, name="face")
    inside = osc.Prismatic([0, 0, 0], [0, 0, 1], hole, name="hole")
    approach: Approach = ({"face": PRESS}, motions.dwell(), ends.made("face", lasting=0.1))
    start = arm.chain.state(q).X_WO
    plan = osc.Plan(_stages(episode, start, approach, {"hole": 0.0}), largest=CEILING)
    return _pressed(episode, arm, plan, [face, inside], GAINS)


def _pressed(
    episode: Episode,
    arm: osc.MujocoArm,
    plan: osc.Plan,
    contacts: Sequence[osc.ContactPair],
    gains: osc.Gains,
) -> str:
    """Follow a plan by our controller; returns how the plan ended.

    Args:
        episode: peg in the hand.
        arm: arm of the environment.
        plan: plan that gives the references.
        contacts: contacts of the plan.
        gains: gains of the controller.
    """
    controller = osc.Controller(
        arm.chain,
        contacts,
        gains,
        B=tilted.METRIC,
        posture=arm.measure().q,
        dt=PERIOD,
        life=osc.PhaseSettings(),
        in_contact=False,
        safety=osc.SafetySettings(contact_ceiling=CEILING, wrist_ceiling=CEILING),
    )
    return _follow(episode, arm, controller, plan)


def impedance(episode: Episode) -> str:
    """Insert the peg by an impedance; returns how its plan ended.

    Args:
        episode: peg in the hand.
    """
    arm = _arm(episode)
    q = arm.measure().q
    push = motions.along(DOWN, 0.01, yields=PRESS)
    approach: Approach = ({}, push, ends.pressed(0.6 * PRESS, DOWN))
    start = arm.chain.state(q).X_WO
    plan = osc.Plan(_stages(episode, start, approach, {}), largest=CEILING)
    controller = osc.Controller(
        arm.chain,
        [],
        laws=osc.impedance(STIFFNESS, damping_ratio=1.0),
        posture=q,
        dt=PERIOD,
        safety=osc.SafetySettings(wrist_ceiling=CEILING),
    )
    return _follow(episode, arm, controller, plan)


def servos(episode: Episode) -> str:
    """Insert the peg by the environment's joint servos; returns an empty text.

    The goal goes down at 10 mm/s to `DEPTH` below the face, then along the spiral; once the hand
    has dropped by `DROP` it goes straight down.

    Args:
        episode: peg in the hand.
    """
    pitch, speed = _spiral(episode)
    per_angle = pitch / (2.0 * np.pi)
    x = episode.hole.rotation @ _about_z(0.5 * np.pi * episode.turns)
    yaw = float(np.arctan2(x[1, 0], x[0, 0]))
    centre = episode.hole.translation - (0.5 * LENGTH + GRIP) * DOWN
    goal = centre - GAP * DOWN
    angle, level, found = 0.0, None, False
    while not (episode.status()[1] or episode.time > LIMIT):
        tcp = _fingertips(episode)
        if goal[2] > centre[2] - DEPTH or found:
            goal = goal + 0.01 * ACTION * DOWN
        else:
            level = tcp[2] if level is None else level + ACTION / RECENT * (tcp[2] - level)
            angle += speed * ACTION / np.hypot(per_angle * angle, per_angle)
            aside = per_angle * angle * np.array([np.cos(angle), np.sin(angle), 0.0])
            goal = centre + DEPTH * DOWN + aside
            if tcp[2] < level - DROP:
                found, goal = True, tcp
        episode.act(ik_action(episode.env, goal, yaw, 1.0))
    return ""


def _fingertips(episode: Episode) -> Array:
    """Place (3,) between the fingertips (m)."""
    data = episode.env.data
    hand = episode.env.model.body(HAND).id
    return np.array(data.xpos[hand] + data.xmat[hand].reshape(3, 3) @ TCP)


RIVALS: dict[str, Callable[[Episode], str]] = {
    "ours": ours,
    "impedance": impedance,
    "joint servos": servos,
}


# --- The comparison -------------------------------------------------------------------------------


@without_log()
def try_inserting(name: str, part: str, off: float, seed: int) -> Tried:
    """Run one episode.

    Args:
        name: controller.
        part: name of the peg.
        off: distance of the hole from its modelled place (mm).
        seed: seed of the episode.
    """
    episode = Episode(part, off, seed)
    return episode.verdict(name, off, seed, RIVALS[name](episode))


def results(jobs: Sequence[tuple[str, str, float, int]], workers: int) -> list[Tried]:
    """Run the episodes that are not kept yet.

    Args:
        jobs: controller, peg, error (mm) and seed of each.
        workers: processes.
    """
    kept = Kept(KEPT, lambda row: Tried(**row))
    left = [job for job in jobs if job not in kept.found]
    for tried in side_by_side(try_inserting, left, workers) if left else ():
        kept.add(tried)
    return [kept.found[job] for job in jobs]


HEADS = (
    "controller; peg; off (mm); seated; P_S; time (s); peak (N), median; largest; "
    "slip (mm), median; turned (°), largest"
)


def row(found: Sequence[Tried]) -> list[object]:
    """Cells of one line: time is the median of those that were seated, slips are of all.

    Args:
        found: verdicts of one controller on one peg with one error.
    """
    first = found[0]
    times = [one.time for one in found if one.seated]
    peaks = [one.peak for one in found]
    return [
        first.name,
        first.part,
        f"{first.off:g}",
        f"{len(times)} of {len(found)}",
        f"{scoring.success_probability(len(times), len(found)):.2f}",
        f"{np.median(times):.1f}" if times else "–",
        f"{np.median(peaks):.0f}",
        f"{max(peaks):.0f}",
        f"{np.median([one.slip for one in found]):.2f}",
        f"{max(one.turned for one in found):.1f}",
    ]


def main(
    seeds: int = 3,
    first: int | None = None,
    parts: str = "peg_round_16",
    off: str = "2",
    rivals: str = ",".join(RIVALS),
    workers: int = 1,
    each: bool = False,
) -> None:
    """Compare controllers; lists are separated by commas.

    Args:
        seeds: episodes of each.
        first: first seed; None: it is drawn, and printed.
        parts: pegs; `all`: all eight.
        off: distances of the hole from its modelled place (mm).
        rivals: controllers.
        workers: processes.
        each: print each episode, too.
    """
    pegs = PEGS if parts == "all" else parts.split(",")
    cases = [
        (name, part, float(one))
        for part in pegs
        for one in off.split(",")
        for name in rivals.split(",")
    ]
    begin = int(np.random.default_rng().integers(FRESH, 10**6)) if first is None else first
    print(f"seeds {begin} to {begin + seeds - 1}: --first {begin}", flush=True)
    jobs = [(*case, seed) for case in cases for seed in range(begin, begin + seeds)]
    found = results(jobs, workers)
    if each:
        for one in found:
            Console(width=200, highlight=False).print(one, soft_wrap=True)
    rows = [row([one for one in found if one.key[:3] == case]) for case in cases]
    Console(width=160).print(table_of(f"pegs of NIST's board 1, {seeds} seeds", HEADS, rows))


if __name__ == "__main__":
    typer.run(main)
