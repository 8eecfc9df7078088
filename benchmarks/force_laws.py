"""Force and motion laws of other software beside ours: one plant, one task, the same model.

    make peers        (or, in its environment: python -m benchmarks.force_laws [--only NAME])

A Panda presses its finger on a wall and moves along it, in MuJoCo at 1 kHz: the cases of
`hybrid_cases` with friction, steps at rest, and a wall that is touched with the arm nearly
stretched. Newton's and robosuite's laws are those of their packages; Isaac Lab's and CRISP's are
rebuilt from their sources. Every law but ours has the simulator's model (pose, J, M, gravity) of
arm and finger, as Isaac Lab's does, and the true contact force. Laws that feed forces back do it
with Isaac Lab's gain of 0.1; the gains of the motion are those of the case, except CRISP's: its
defaults in N/m.
"""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
import typer
from rich.console import Console

import osc_contact as osc
from benchmarks.hybrid_cases import CASES, MUJOCO, Case, goal_times, scenario_of
from osc_contact.spatial import Array, pose_error
from paper.study import table_of, with_object

FEEDBACK = 0.1  #: of forces, Isaac Lab's tests
POSTURE = 10.0  #: 1/s², critically damped, in the null space
FRICTION = 0.3
STEP_S = 0.4
FORCE_STEP = 5.0  #: N
MOTION_STEP = 5e-3  #: m

_CASE = CASES[0]
_FAR = _CASE.goals[0]._replace(point=(0.6, 0.67, 0.5))
STRETCHED = _CASE._replace(name="stretched", goals=(_CASE.goals[0], _FAR, _CASE.goals[0]))
"""9 mm before the arm is stretched, where J loses a rank."""


# --- What a law is given, and the laws -----------------------------------------------------------


class Sight:
    """The simulator's arm at one instant; tool: the finger's middle, world axes.

    Attributes:
        q, v: (7,) rad, rad/s.
        X: pose of the tool.
        V: (6,) its twist.
        J: (6, 7).
        M: (7, 7).
        gravity, coriolis: (7,) N m.
        force: force of the contact (N).
        axis: (3,) into the wall.
        goal: pose of the tool.
        V_goal: (6,).
        force_goal: N.
        error: (6,) from the tool to its goal (m, rad), world axes.
    """

    def __init__(
        self, plant: Any, held: tuple[pin.Model, int], axis: Array, reference: osc.Reference
    ) -> None:
        """Now, with what is desired.

        Args:
            plant: in MuJoCo.
            held: model of the arm with its finger, and the tool's frame.
            axis: into the wall.
            reference: desired motion and forces.
        """
        model, tool = held
        data = model.createData()
        now = plant.measure()
        self.q = now.q
        self.v = now.v
        pin.computeAllTerms(model, data, now.q, now.v)
        self.J = pin.getFrameJacobian(model, data, tool, pin.LOCAL_WORLD_ALIGNED)
        self.X = pin.updateFramePlacement(model, data, tool)
        self.M = np.array(data.M)
        self.gravity = np.array(data.g)
        self.coriolis = data.nle - self.gravity
        self.V = self.J @ self.v
        self.force = float(plant.truth().alpha[0])
        self.axis = axis
        self.goal = reference.X_WD
        self.V_goal = reference.V_D
        self.force_goal = float(reference.alpha_d[0])
        self.error = pose_error(self.goal, self.X)


Law = Callable[[Sight], Array]  #: torques
Makes = Callable[[Sight, Case], Law]  #: from the start


def _frame(axis: Array) -> Array:
    """(3, 3) axes of the wall, the third one into it."""
    side = np.array([0.0, 1.0, 0.0])
    return np.column_stack((side, np.cross(axis, side), axis))


def newton(start: Sight, case: Case, projection: bool) -> Law:
    """Newton 1.8's `ControllerOperationalSpaceModelFree`, the real one, on the CPU."""
    import warp as wp
    from newton.controllers import ControllerOperationalSpaceModelFree

    wp.config.quiet = True
    R = _frame(start.axis)
    frame = pin.SE3(R, np.zeros(3))
    controller = ControllerOperationalSpaceModelFree(
        controlled_dofs_per_robot=wp.array([len(start.q)], dtype=wp.int32, device="cpu"),
        motion_stiffness=case.stiffness,
        motion_damping=case.damping,
        operational_frame_pose_world=wp.transform(*pin.SE3ToXYZQUAT(frame)),
        use_wrench_feedforward=True,
        use_wrench_feedback=True,
        use_motion_wrench_projection=projection,
        motion_selection_axes=wp.spatial_vector(1.0, 1.0, 0.0, 1.0, 1.0, 1.0),
        wrench_selection_axes=wp.spatial_vector(0.0, 0.0, 1.0, 0.0, 0.0, 0.0),
        wrench_stiffness=FEEDBACK,
        use_null_space_control=True,
        null_space_stiffness=POSTURE,
        null_space_damping=2.0 * POSTURE**0.5,
        device="cpu",
    )
    inputs, outputs = controller.input(), controller.output()
    inputs.joint_q_des_null.assign(start.q)

    def law(s: Sight) -> Array:
        wrench = np.r_[s.axis, np.zeros(3)]
        twist = np.r_[R.T @ s.V_goal[:3], R.T @ s.V_goal[3:]]
        for port, value in (
            (inputs.tool_pose_world, pin.SE3ToXYZQUAT(s.X)),
            (inputs.tool_twist_world, s.V),
            (inputs.jacobian_tool_world, s.J),
            (inputs.mass_matrix, s.M),
            (inputs.gravity_force, s.gravity),
            (inputs.desired_tool_pose_operational, pin.SE3ToXYZQUAT(frame.actInv(s.goal))),
            (inputs.desired_twist_operational, twist),
            (inputs.desired_wrench_world, s.force_goal * wrench),
            (inputs.measured_wrench_world, s.force * wrench),
            (inputs.joint_q, s.q),
            (inputs.joint_qd, s.v),
        ):
            port.assign(np.asarray(value, np.float32).reshape(port.numpy().shape))
        controller.step(inputs=inputs, outputs=outputs, dt=1e-3)
        return outputs.joint_f.numpy().astype(float)

    return law


def isaac_lab(start: Sight, case: Case, thresholds: tuple[float, float] | None) -> Law:
    """Isaac Lab's `OperationalSpaceController`, rebuilt; full decoupling and posture control.

    Args:
        start, case: start and case of the run.
        thresholds: of Isaac Lab 3: eigenvalues of J M⁻¹Jᵀ relative to the largest, below which
            directions are damped (pull request 7903); None: the plain inverse of before.
    """
    force = np.zeros((6, 6))  # Ω̄, and Ω: everything but the force along the axis moves
    force[:3, :3] = np.outer(start.axis, start.axis)
    motion = np.eye(6) - force

    def inverse(Phi: Array) -> Array:
        if thresholds is None:
            return np.linalg.inv(Phi)
        low, high = thresholds
        values, vectors = np.linalg.eigh(0.5 * (Phi + Phi.T))
        share = np.clip((values / values[-1] - low) / (high - low), 0.0, 1.0)
        weight = share**2 * (3.0 - 2.0 * share)
        return (vectors / (values + low * values[-1] * (1.0 - weight))) @ vectors.T

    def law(s: Sight) -> Array:
        Lambda = inverse(s.J @ np.linalg.solve(s.M, s.J.T))
        a = motion @ (case.stiffness * s.error) - motion @ (case.damping * s.V)
        pressed = s.force_goal + FEEDBACK * (s.force_goal - s.force)
        F = motion @ Lambda @ a + force @ np.r_[s.axis * pressed, np.zeros(3)]
        posture = POSTURE * (start.q - s.q) - 2.0 * POSTURE**0.5 * s.v
        return s.J.T @ (F - Lambda @ s.J @ posture) + s.M @ posture + s.gravity

    return law


def robosuite(start: Sight, case: Case) -> Law:
    """robosuite's `OperationalSpaceController`, the real `run_controller`.

    It has no force command: the goal lies as deep in the wall as presses with the force at the
    start.
    """
    from types import SimpleNamespace

    from robosuite.controllers.parts.arm.osc import OperationalSpaceController

    class Fed(OperationalSpaceController):  # type: ignore[misc]
        """Takes its states from us, not from a simulation of robosuite's."""

        def __init__(self) -> None:
            self.kp = np.full(6, case.stiffness)
            self.kd = np.full(6, case.damping)
            self.interpolator_pos = self.interpolator_ori = None
            self.input_ref_frame = "world"
            self.uncoupling = True
            self.initial_joint = start.q
            self.naming_prefix = self.part_name = ""
            still = SimpleNamespace(
                get_site_xvelp=lambda _: np.zeros(3), get_site_xvelr=lambda _: np.zeros(3)
            )
            self.sim = SimpleNamespace(data=still)

        def update(self, force: bool = False) -> None:
            """Done by the law below."""

        @property
        def torque_compensation(self) -> Array:
            """Gravity and velocity terms."""
            return self.bias

    controller = Fed()
    Phi = start.J[:3] @ np.linalg.solve(start.M, start.J[:3].T)
    depth = 1.0 / (case.stiffness * start.axis @ np.linalg.solve(Phi, start.axis))  # m/N

    def law(s: Sight) -> Array:
        controller.goal_pos = s.goal.translation + depth * s.force_goal * s.axis
        controller.goal_ori = s.goal.rotation
        controller.ref_pos, controller.ref_ori_mat = s.X.translation, s.X.rotation
        controller.ref_pos_vel, controller.ref_ori_vel = s.V[:3], s.V[3:]
        controller.joint_pos, controller.joint_vel = s.q, s.v
        controller.J_full, controller.J_pos, controller.J_ori = s.J, s.J[:3], s.J[3:]
        controller.mass_matrix = s.M
        controller.bias = s.gravity + s.coriolis
        return np.array(controller.run_controller())

    return law


def crisp(start: Sight, case: Case) -> Law:
    """crisp_controllers' Cartesian impedance with a target wrench, in open loop; rebuilt.

    Its default gains but none along the axis; axes of the tool, error limits and filter of the
    target pose as by default, with compensation of gravity and velocity terms.
    """
    stiffness = np.array([500.0, 500.0, 0.0, 30.0, 30.0, 30.0])
    damping = 2.0 * stiffness**0.5
    clip = np.repeat([0.1, 0.5], 3)
    target = start.X.copy()

    def law(s: Sight) -> Array:
        nonlocal target
        target = pin.SE3.Interpolate(target, s.goal, 0.1)
        R = s.X.rotation
        J = np.vstack((R.T @ s.J[:3], R.T @ s.J[3:]))
        off = R.T @ (target.translation - s.X.translation)
        error = np.clip(np.r_[off, pin.log3(R.T @ target.rotation)], -clip, clip)
        wrench = np.r_[R.T @ s.axis * s.force_goal, np.zeros(3)]
        posture = (np.eye(len(s.q)) - np.linalg.pinv(J) @ J) @ (start.q - s.q - 2.0 * s.v)
        F = stiffness * error - damping * (J @ s.v) + wrench
        return J.T @ F + np.clip(posture, -5.0, 5.0) + s.gravity + s.coriolis

    return law


OURS = "ours"
DAMPED = (1e-5, 1e-4)  #: Isaac Lab's defaults
LAWS: dict[str, Makes | None] = {
    OURS: None,
    "Newton 1.8": lambda s, c: newton(s, c, projection=False),
    "Newton 1.8, projected": lambda s, c: newton(s, c, projection=True),
    "Isaac Lab 3, rebuilt": lambda s, c: isaac_lab(s, c, DAMPED),
    "robosuite 1.5": robosuite,
    "CRISP, rebuilt": crisp,
}
UNDAMPED = "Isaac Lab 2, rebuilt"  #: without damping near singular postures


# --- One run --------------------------------------------------------------------------------------


class Done(NamedTuple):
    """Result of a law, tick by tick.

    Attributes:
        planned: ticks of the whole run.
        force, force_goal: (k,) N.
        off: (k, 6) from the object to its goal in the axes of the wall, the third one into it (m,
            rad).
        tau: (k, 7) N m.
        speed: (k, 7) rad/s.
        tick: (k,) µs of the law itself.
    """

    planned: int
    force: Array
    force_goal: Array
    off: Array
    tau: Array
    speed: Array
    tick: Array

    def rms(self) -> tuple[float, ...]:
        """Rms errors after 100 ticks: force (N), place along the wall (mm), rotation (mrad).

        They are NaN if the run ended early.
        """
        if len(self.force) < self.planned:
            return (np.nan,) * 3
        off = 1e3 * self.off
        parts = ((self.force - self.force_goal)[:, None], off[:, :2], off[:, 3:])
        return tuple(float(np.sqrt((x[100:] ** 2).sum(axis=1).mean())) for x in parts)


def follow(scenario: osc.Scenario, case: Case, makes: Makes | None) -> Done:
    """Run a law through the task."""
    rig = osc.build_rig(scenario)
    plant: Any = rig.plant()
    controller = rig.controller()
    held = with_object(rig.chain)
    axis = -case.normal
    turn = _frame(axis)
    period = controller.dt
    count = round(scenario.duration * scenario.control.rate)
    first = rig.references.at(0.0)
    plant.hold(controller.tick(plant.measure(), first))
    law = None if makes is None else makes(Sight(plant, held, axis, first), case)
    limits = rig.chain.model.upperEffortLimit
    rows = []
    for reference in rig.references.each(count, period):
        measured = plant.measure()
        sight = Sight(plant, held, axis, reference)
        begin = perf_counter()
        tau = controller.tick(measured, reference) if law is None else law(sight)
        took = 1e6 * (perf_counter() - begin)
        off = (sight.error.reshape(2, 3) @ turn).ravel()
        rows.append((sight.force, sight.force_goal, off, tau, sight.v, took))
        if not np.isfinite(tau).all():
            break
        try:
            plant.command(np.clip(tau, -limits, limits), period)
        except osc.PlantError:
            break
    return Done(count, *map(np.array, zip(*rows, strict=True)))


# --- The tables -----------------------------------------------------------------------------------


def of_the_tests(names: list[str], friction: float) -> list[str]:
    """A row for each case and law: errors at the goals, and over the whole run."""
    rows = []
    for case in CASES:
        scenario = scenario_of(case, plant=MUJOCO | {"friction": friction})
        for name in names:
            done = follow(scenario, case, LAWS[name])
            rest = [round(1e3 * t) - 1 for t in goal_times(case)]
            force, along, turn = done.rms()
            at_rest = np.abs(done.force - done.force_goal).take(rest, mode="clip").max()
            rows.append(f"{case.name}; {name}; {at_rest:.2f}; {force:.2f}; {along:.2f}; {turn:.1f}")
    return rows


def steps() -> osc.Scenario:
    """At rest: a step of the force, then one of the motion."""
    held = {"type": "constant", "value": _CASE.goals[0].force}
    force = {"type": "step", "value": FORCE_STEP, "start": STEP_S}
    aside = {"type": "step", "value": MOTION_STEP, "start": 2.0 * STEP_S}
    direction = _frame(-_CASE.normal)[:, 1]
    return scenario_of(
        _CASE,
        force={"finger": [held, force]},
        motion=[{"kind": "linear", "direction": direction, "signals": [aside]}],
        duration=3.0 * STEP_S,
    )


def of_steps(names: list[str]) -> list[str]:
    """A row for each law: what a step of one does to the other, and its tick."""
    rows = []
    at = round(1e3 * STEP_S)
    for name in names:
        done = follow(steps(), _CASE, LAWS[name])
        moved = done.off[at : 2 * at, :2] - done.off[at - 1, :2]
        pressed = np.abs(done.force - done.force_goal)[2 * at :]
        moved_um = 1e6 * np.linalg.norm(moved, axis=1).max()
        tick = "; ".join(f"{time:.0f}" for time in np.percentile(done.tick[10:], (50, 99)))
        rows.append(f"{name}; {moved_um:.0f}; {pressed.max():.2f}; {tick}")
    return rows


def of_the_stretched_arm(names: list[str]) -> list[str]:
    """A row for each law and speed: along the wall until the arm is nearly stretched, and back."""
    rows = []
    laws = {name: LAWS[name] for name in names} | {UNDAMPED: lambda s, c: isaac_lab(s, c, None)}
    for move_s in (2.0, 8.0):
        case = STRETCHED._replace(move_s=move_s)
        limits = osc.build_rig(scenario_of(case)).chain.model
        for name, makes in laws.items():
            done = follow(scenario_of(case), case, makes)
            force, along, turn = done.rms()
            torque = (np.abs(done.tau[100:]) / limits.upperEffortLimit).max()
            speed = (np.abs(done.speed) / limits.upperVelocityLimit).max()
            rows.append(
                f"{move_s:g}; {name}; {force:.2f}; {along:.2f}; {turn:.1f}; {100 * torque:.0f}; "
                f"{100 * speed:.0f}"
            )
    return rows


def main(only: str = "") -> None:
    """Print the three tables.

    Args:
        only: laws whose names contain this.
    """
    names = [name for name in LAWS if only in name]
    show = Console(width=120).print
    head = "case; law; at the goals (N); force rms (N); along the wall (mm); turn (mrad)"
    for friction in (0.0, FRICTION):
        title = f"Isaac Lab's hybrid tests rebuilt, friction {friction:g}: force and motion errors"
        show(table_of(title, head, of_the_tests(names, friction)))
    head = "law; 5 N step moves it by (µm); 5 mm step: force error (N); tick p50 (µs); p99 (µs)"
    show(table_of("cross-coupling at rest, and the law's own time", head, of_steps(names)))
    head = "way (s); law; force rms (N); along (mm); turn (mrad); torque (%); speed (%)"
    title = f"to {_FAR.point[1]:g} m aside, where the arm is nearly stretched, and back"
    show(table_of(title, head, of_the_stretched_arm(names)))


if __name__ == "__main__":
    typer.run(main)
