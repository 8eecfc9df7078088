"""Postures outside joint limits and wrists that read a wrong weight are found at the start."""

from dataclasses import replace

import numpy as np
from complaints import model_error
from numpy.random import default_rng
from rigs import held_tick, largest, refused, ticked, unloaded
from samples import parametrize
from test_own_mujoco import MOTORS, START, WALL, ready, robot_of, scene

import osc_contact as osc

DEGREES = np.degrees(START)
# the elbow is limited to ±2; the posture is a goal, which only wrong units bring this far out
OUT = {"reset": 3.0, "touching": 3.0, "posture": 200.0}


def limited(**how):
    """The arm of `scene`, its joints limited to ±2 rad."""
    spec = osc.robots.mjcf.compile_mjcf(scene(MOTORS, **how))
    for name in ("shoulder", "elbow", "wrist_pitch"):
        spec.joint(name).range = (-2.0, 2.0)
        spec.jnt_limited[spec.joint(name).id] = 1
    return robot_of(spec)


@parametrize("door", ["reset", "touching", "posture"])
def test_postures_outside_the_limits_are_refused_with_numbers_and_cure(door):
    robot = limited()
    doors = {
        "reset": robot.reset,
        "touching": robot.touching,
        "posture": lambda q: osc.Controller(robot.chain, [WALL], posture=q),
    }
    words = rf"arm/elbow at {OUT[door]:g} is outside its limits \[-2, 2\].* file"
    with refused(words):
        doors[door](np.array([0.3, OUT[door], -1.2]))
    with refused(r"look like degrees: give np.radians"):
        doors[door](np.array(DEGREES))
    doors[door](np.array(START))


@parametrize("sign", [-1.0, 1.0])
def test_a_posture_may_be_a_goal_beyond_the_limits_by_less_than_one_and_a_half_ranges(sign):
    chain = limited().chain
    near = np.array([0.3, sign * 7.9, -1.2])
    far = np.array([0.3, sign * 8.1, -1.2])
    assert osc.Controller(chain, [WALL], posture=near).settings.posture[1] == near[1]
    with refused(r"posture: joint arm/elbow at .* is outside"):
        osc.Controller(chain, [WALL], posture=far)


def test_a_touching_posture_outside_the_limits_is_refused():
    far = limited(wall=0.5)
    far.contacts = [osc.VertexOnFace([0, 0, 0], [0.1, 0, 0.5], [-1, 0, 0], name="behind")]
    with model_error(r"touching: joint .* is outside"):
        far.touching([1.9, 1.9, 0.0])


def test_a_controller_that_starts_outside_the_limits_holds_and_stops():
    robot = limited()
    q = np.array(START)
    controller = osc.Controller(robot.chain, [], posture=q)
    goal = osc.Reference(robot.chain.state(q, np.zeros(3)).X_WO)
    read = unloaded(DEGREES, np.zeros(3))
    for _ in range(25):
        tau = held_tick(controller, "look like degrees", read, goal)
        assert np.isfinite(tau).all() and largest(tau) < 40.0
    assert controller.state is osc.SafetyState.SAFE_STOP
    controller.reset()
    ticked(controller, replace(read, q=q), goal)


def free_run(change, tick=lambda k, controller: None, ticks=300, engaged=True, **how):
    """Ticks of the arm at rest 20 mm before the wall, its wrist readings changed."""
    robot = robot_of(scene())
    robot.contacts = (replace(WALL, point=[0.48, 0, 0.5]),)
    controller, X = ready(robot, life=osc.PhaseSettings(), engaged=engaged, **how)
    rng = default_rng(1)
    for k in range(ticks):
        read = robot.measure()
        noise = rng.standard_normal((1, 6)) * np.repeat([0.3, 0.006], 3)
        wrench = change(read.wrenches.copy(), robot) + noise
        tau = controller.tick(replace(read, wrenches=wrench), osc.Reference(X, alpha_d=[5.0]))
        tick(k, controller)
        if controller.state is osc.SafetyState.SAFE_STOP:
            break
        robot.command(tau, controller.dt)
    return controller, k


def without_gravity(wrench, robot):
    load = 0.32 * 9.81 * robot.data.site("wrist").xmat.reshape(3, 3).T @ [0, 0, 1.0]
    return wrench - np.concatenate((load, np.zeros(3)))


CHANGES = {
    "as it is": (lambda w, robot: w, None),
    "without gravity": (without_gravity, "without gravity"),
    "reversed": (lambda w, robot: -w, "the sign is reversed"),
    "offset": (lambda w, robot: w + [0, 3, 0, 0, 0, 0], "tare"),
    "torque": (lambda w, robot: w + [0, 0, 0, 0, 0.9, 0], "N m"),
    "little": (lambda w, robot: w + [0, 1.2, 0, 0, 0, 0], None),
}


@parametrize("name", CHANGES)
@parametrize("engaged", [True, False])
def test_a_wrist_that_reads_another_weight_is_refused_before_contact(name, engaged):
    change, cause = CHANGES[name]

    def engage(k, controller):
        if k == 100 and not engaged:
            controller.engage()

    controller, ticks = free_run(change, engage, engaged=engaged)
    if cause is None:
        assert ticks == 299 and controller.status is not osc.Status.HELD, controller.reason
        return
    assert ticks < 100 + 100 * (not engaged)
    assert controller.state is osc.SafetyState.SAFE_STOP
    for word in (cause, "load_error = 2 N", "wrist", "frame"):
        assert word in controller.reason


def test_a_tare_answers_an_offset_and_a_limit_can_be_set():
    def tare(k, controller):
        if k == 90:
            controller.f_tare = controller.residual_wrench()
            controller.engage()

    offset = CHANGES["offset"][0]
    controller, ticks = free_run(offset, tare, engaged=False)
    assert ticks == 299 and controller.status is not osc.Status.HELD
    assert free_run(offset, ticks=80, safety=osc.SafetySettings(load_error=5.0))[1] == 79
    with refused("load_error: must be > 0"):
        osc.SafetySettings(load_error=0.0)
