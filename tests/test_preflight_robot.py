"""A robot of one's own is looked at before it runs, and compared with its MuJoCo scene."""

from dataclasses import replace

import mujoco
import numpy as np
from complaints import invalid_input
from pytest import approx, mark
from test_own_mujoco import START, WALL, robot_of, scene, wiping

import osc_contact as osc


def task(model=None, pair=WALL, alpha=10.0, amplitude=0.02, ticks=1500, guess=START, **how):
    """Robot, controller and references of an arm that wipes a wall."""
    robot = robot_of(scene() if model is None else model, contacts=[pair])
    start = robot.touching(guess)
    robot.reset(start)
    controller = osc.Controller(robot.chain, [pair], posture=start, **how)
    along = wiping(robot.chain.state(start, np.zeros(3)).X_WO, amplitude, alpha)
    return robot, controller, [along(1e-3 * k) for k in range(ticks)]


def heavy(factor):
    model = scene()
    model.body_mass[:] *= factor
    model.body_inertia[:] *= factor
    model.actuator_ctrllimited[:] = 1
    model.actuator_ctrlrange[:] = -40, 40
    return model


NEAR = [0.3, 0.4, -1.2]


def short(limit):
    """The elbow's range ends so far beyond its position in contact."""
    model = scene()
    at = robot_of(model).touching(NEAR)[1]
    model.joint("elbow").range[:] = at - limit, at + limit
    model.joint("elbow").limited[:] = 1
    return model


def moved(**change):
    return {"pair": replace(WALL, **change)}


def tool_radius(radius):
    model = scene()
    model.geom("tool").size[0] = radius
    return model


AT = 0.4298  #: m, where the tip begins
TILTED = [-np.cos(0.2), 0, np.sin(0.2)]
WRONG = {
    "wall 20 mm deeper": (lambda: {"model": scene(wall=0.52)}, "20 mm before the nearest"),
    "wall 20 mm nearer": (lambda: {"model": scene(wall=0.48)}, "20 mm inside the nearest geom, 'w"),
    "reversed normal": (lambda: moved(normal=[1, 0, 0]), "180 deg away from that of 'wall'"),
    "tilted normal": (lambda: moved(normal=TILTED, point=[0.5, 0, AT]), "11.5 deg away"),
    "mass in grams": (lambda: {"model": heavy(1000.0)}, "are masses in kg"),
    "15,000 N": (lambda: {"alpha": 15e3}, "force_range = 1000 N"),
    "a force that pulls": (lambda: {"alpha": -10.0}, "cannot pull"),
    "step of MuJoCo": (lambda: {"model": scene(step=0.0007)}, "no whole number of MuJoCo's steps"),
    "end of a joint": (lambda: {"model": short(0.05), "guess": NEAR}, "arm/elbow"),
    "tool of another size": (lambda: {"model": tool_radius(0.005)}, "the tool is 10 mm away"),
    "slow loop": (lambda: {"gains": osc.Gains(osc.MotionGains(400.0, 900.0))}, "control.rate"),
}


@mark.parametrize("name", WRONG)
def test_what_is_wrong_is_found_before_it_runs(name):
    make, words = WRONG[name]
    found = osc.preflight(*task(**make()))
    kinds = {one.refused for one in found if words in one.text}
    assert kinds == {name not in ("tilted normal", "slow loop")}, found


def test_a_sound_task_is_passed_and_left_as_it_is():
    robot, controller, references = task()
    assert osc.preflight(robot, controller, iter(references)) == ()
    assert not controller._records.memory.ticked and robot.time == 0.0
    osc.run_loop(robot, controller, references)
    assert robot.truth().alpha[0] == approx(10.0, rel=0.02)


def test_a_joint_too_fast_is_named_with_its_time():
    robot, controller, references = task(amplitude=0.2, ticks=800)
    robot.chain.model.velocityLimit[:] = 0.5
    (one,) = osc.preflight(robot, controller, references)
    assert one.refused and "above its speed limit of 0.5" in one.text and "at t = 0." in one.text


def test_a_controller_with_other_masses_is_found():
    robot, _, references = task()
    other = robot_of(heavy(1.3)).chain
    controller = osc.Controller(other, [WALL], posture=robot.measure().q)
    found = [x for x in osc.preflight(robot, controller, references) if "weighs" in x.text]
    assert [(x.text.split(" weighs")[0], x.refused) for x in found] == [
        ("all that moves", False),
        ("what the wrist carries", False),
    ]


class WithoutGravity:
    """A robot whose wrist reads forces without the weight of the hand, 20 mm off the wall."""

    def __init__(self):
        self.inner = robot_of(scene())
        self.inner.contacts = [replace(WALL, point=[0.48, 0, 0.5])]
        self.inner.reset(self.inner.touching(START))
        self.chain = self.inner.chain

    def measure(self):
        read = self.inner.measure()
        return replace(read, wrenches=np.zeros((1, 6)))


def test_a_wrist_without_gravity_is_refused_at_the_door():
    robot = WithoutGravity()
    q = robot.measure().q
    controller = osc.Controller(robot.chain, [WALL], posture=q, life=osc.PhaseSettings())
    X = robot.chain.state(q, np.zeros(3)).X_WO
    for judged, shift, words in (
        (robot, 0.0, "without gravity"),
        (robot.inner, 0.2, "0.2 m away from where it is"),
    ):
        goal = osc.pose_reference(X.translation + [0, 0, shift], X.rotation, alpha_d=[5.0])
        (one,) = osc.preflight(judged, controller, [goal])
        assert one.refused and words in one.text


def test_what_cannot_be_looked_at_is_refused():
    robot, controller, references = task()
    bad = [replace(references[0], alpha_d=np.zeros(2))]
    for given, words in (
        ((), "its controller and references"),
        ((controller, []), "no references"),
        ((controller, bad), "1 columns of N"),
    ):
        with invalid_input(words):
            osc.preflight(robot, *given)


def test_distances_in_a_scene_are_those_of_its_shapes():
    model = mujoco.MjModel.from_xml_string("""
    <mujoco><asset><mesh name="cube" vertex="-1 -1 -1 1 -1 -1 1 1 -1 -1 1 -1 -1 -1 1 1 -1 1 1 1 1
      -1 1 1"/></asset>
    <worldbody><geom type="plane" size="5 5 1"/>
    <geom name="die" type="mesh" mesh="cube" pos="5 0 3"/>
    <geom name="box" type="box" size="1 1 1" pos="0 0 3"/>
    <body name="hand" pos="0 0 6"><joint type="slide"/><geom size="0.1" mass="1"/></body>
    </worldbody></mujoco>""")
    robot = osc.MujocoRobot.from_model(model, tip="hand")
    probe = robot.probe()
    for point, want in (
        ([0, 0, 4.5], 0.5),
        ([0, 0, 3.7], -0.3),
        ([0, 0.9, 3], -0.1),
        ([3, 0, 0.2], 0.2),
        ([5, 0, 4.2], 0.2),
        ([3, 0, -0.4], -0.4),
        ([5, 0, 3.8], -0.2),
    ):
        assert probe.distance(np.array(point, dtype=float))[0] == approx(want, abs=1e-5)
    assert probe.clearance() == (approx(1.9), "box")
