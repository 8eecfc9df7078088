"""A user's own MuJoCo scene as robot and judge, looked at before it runs, and its pictures."""

import json
from copy import copy
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import mujoco
import numpy as np
from command_line import done, refused
from complaints import invalid_input, model_error, plant_error
from headless import Browser, near, pixels_of
from numpy.testing import assert_array_equal
from PIL import Image
from pytest import approx, raises
from rigs import assert_near, data_at, held_tick, largest, ticked, unloaded, vector
from samples import module_fixture, parametrize
from scenario_runs import worst_force

import osc_contact as osc
from osc_contact.robots.pictures import read_picture

MOTORS = """<motor joint="wrist_pitch" gear="-5" ctrllimited="true" ctrlrange="-20 20"/>
<motor joint="shoulder" gear="10"/><motor joint="elbow"/>"""
SERVOS = """<position joint="elbow" kp="300"/><motor joint="shoulder"/>
<velocity joint="wrist_pitch" kv="30"/>"""
SENSORS = '<force site="wrist"/> <torque site="wrist"/>'
START = [0.3, 0.9, -1.2]


def scene(actuators=MOTORS, step=0.0005, sensors=SENSORS, wall=0.5):
    """A planar arm with a finger on its tool, behind a loose ball, before a wall."""
    return mujoco.MjModel.from_xml_string(f"""
<mujoco>
  <compiler angle="radian"/>
  <option timestep="{step}"/>
  <default><joint axis="0 1 0" damping="0.4" armature="0.1" frictionloss="0.1"/></default>
  <worldbody>
    <geom name="floor" type="plane" size="3 3 0.1" contype="2" conaffinity="2"/>
    <geom name="wall" type="box" size="0.05 1 1" pos="{wall + 0.05} 0 0.5" priority="1"
          solref="0.01 1" solimp="0.2 0.9 0.0005" friction="0.1"/>
    <body name="ball" pos="-1 0 0.1"> <freejoint/>
      <geom size="0.1" mass="1" contype="2" conaffinity="2"/>
    </body>
    <body name="base" pos="0 0 0.3">
      <geom size="0.05"/>
      <body>
        <joint name="shoulder"/>
        <geom name="upper" type="capsule" fromto="0 0 0.1 0 0 0.38" size="0.03" mass="3"/>
        <body pos="0 0 0.4">
          <joint name="elbow"/>
          <geom name="lower" type="capsule" fromto="0.05 0 0 0.28 0 0" size="0.03" mass="2"/>
          <body pos="0.3 0 0">
            <joint name="wrist_pitch"/>
            <geom size="0.02" mass="0.5"/>
            <body name="hand" pos="0.04 0 0" euler="0 0.2 0">
              <site name="wrist" euler="0.3 0.1 0"/> <site name="bare"/>
              <geom name="tool" size="0.015" pos="0.1 0 0" mass="0.3"/>
              <site name="tip" pos="0.1 0 0" euler="0 0.4 0"/>
              <body name="finger" pos="0 0.05 0">
                <joint name="grip" type="slide"/>
                <geom size="0.01" mass="0.02" contype="0" conaffinity="0"/>
              </body>
            </body>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator> {actuators} <position joint="grip" kp="2000" ctrlrange="-1 1"/> </actuator>
  <sensor> {sensors} </sensor>
  <keyframe>
    <key name="ball_aside" qpos="-2 0 0.1 1 0 0 0 0 0 0 0.03" ctrl="{"0 " * 3 * bool(actuators)}0.03"/>
  </keyframe>
</mujoco>""")  # noqa: E501


WALL = osc.VertexOnFace([0, 0, 0], [0.5, 0, 0.5], [-1, 0, 0], radius=0.015, name="wall")


def robot_of(model, **how):
    how = {"tip": "tip", "wrist_sensor": "wrist", "contacts": [WALL]} | how
    return osc.MujocoRobot.from_model(model, **how)


def ready(robot, pair=WALL, guess=START, **how):
    """A controller of the robot, which touches now, and its pose."""
    start = robot.touching(guess)
    robot.reset(start)
    controller = osc.Controller(robot.chain, [pair], posture=start, **how)
    return (controller, robot.chain.state(start).X_WO)


def wiping(X, amplitude=0.04, alpha=10.0):
    """References along a wall from X on, to and fro along z, as a function of time."""
    w = 3.0

    def along(t):
        along_z = (1 - np.cos(w * t), w * np.sin(w * t), w**2 * np.cos(w * t))
        p, v, a = np.outer(along_z, [0, 0, amplitude])
        return osc.pose_reference(X.translation + p, X.rotation, v, a, alpha_d=[alpha])

    return along


def pushes(robot, geoms):
    """(N) what in MuJoCo its contacts with these geoms of the robot carry, along the normal."""
    numbers = {robot.model.geom(name).id for name in geoms}
    force = np.zeros(6)
    total = 0.0
    for i, contact in enumerate(robot.data.contact):
        if numbers & {*contact.geom}:
            mujoco.mj_contactForce(robot.model, robot.data, i, force)
            total += force[0]
    return total


class Spy(osc.Recorder):
    """Also by MuJoCo itself."""

    def __init__(self, controller, robot):
        super().__init__(controller, robot)
        self.robot = robot
        self.pushes = []

    def append(self, *tick):
        self.pushes.append(pushes(self.robot, ["tool"]))
        super().append(*tick)


@parametrize("actuators", [MOTORS, SERVOS, ""], ids=["motors", "servos", "none"])
def test_scene_is_robot_and_judge(actuators):
    robot = robot_of(scene(actuators), locked={"grip": 0.03}, keyframe="ball_aside")
    assert robot.chain.joint_names == ["arm/shoulder", "arm/elbow", "arm/wrist_pitch"]
    controller, X = ready(robot)
    assert_near(robot.measure().q, controller.posture)
    spy = Spy(controller, robot)
    osc.run_loop(robot, controller, map(wiping(X), np.arange(0, 2.5, 1e-3)), recorder=spy)
    recording = spy.recording()
    assert_near(recording["alpha_true"][:, 0], spy.pushes, atol=1e-9)
    verdict = osc.metrics(recording)
    assert worst_force(verdict) < 5e-3 and verdict["motion"]["rms_error_m"] < 1e-4
    assert verdict["contact_fraction"]["wall"] == 1.0
    assert verdict["task"]["word"] == "OK" and verdict["scenario"] is None
    assert np.ptp(recording["pose"][:, 2]) > 0.07  # it went there
    site = robot.data.site("tip")
    assert_near(robot.poses()[1, :3, 3], site.xpos, atol=1e-12)
    assert_near(robot.poses()[1, :3, :3].ravel(), site.xmat, atol=1e-12)
    assert robot.data.joint("grip").qpos[0] == approx(0.03, abs=1e-3)
    assert robot.data.body("ball").xpos[0] == approx(-2.0, abs=1e-3)


def test_only_the_tool_touches():
    robot = robot_of(scene(wall=0.25))  # the elbow is through it
    robot.reset([0.6, 0.5, 0.0])
    assert pushes(robot, ["upper", "lower"]) > 1.0
    truth = robot.truth()
    assert pushes(robot, ["tool"]) == 0.0 and truth.alpha[0] == 0.0 and not truth.closed[0]


@parametrize("friction, reported", {0.1: False, 0.6: True})
def test_much_friction_is_reported(caplog, friction, reported):
    model = scene()
    model.geom("wall").friction[0] = friction
    robot_of(model)
    assert ("friction of tool and scene has a coefficient of 0.6" in caplog.text) == reported


def test_the_model_given_stays_as_it_is():
    model = scene(SERVOS)
    before = copy(model)
    robot = robot_of(model)
    assert_array_equal(model.actuator_gainprm, before.actuator_gainprm)
    assert_array_equal(model.actuator_biasprm, before.actuator_biasprm)
    assert model.opt.cone == before.opt.cone != robot.model.opt.cone


@parametrize(
    "words, how",
    {
        "no body or site 'tipp'; did you mean 'tip'": {"tip": "tipp"},
        "no site 'wirst'; did you mean 'wrist'": {"wrist_sensor": "wirst"},
        r'no torque sensor; .*<torque site="bare"/>': {"wrist_sensor": "bare"},
        "no keyframe 'ball_asid'; did you mean 'ball_aside'": {"keyframe": "ball_asid"},
        "no moving joint called 'elbo'": {"locked": {"elbo": 0.0}},
    },
)
def test_what_is_not_there_is_named_with_a_cure(how, words):
    with raises(osc.OscContactError, match=words):
        robot_of(scene(sensors=f'{SENSORS} <force site="bare"/>'), **how)


def test_a_step_that_does_not_fit_the_control_period_is_refused():
    robot = robot_of(scene(step=0.002))
    with plant_error(r"1 ms is no whole number .* steps of 2 ms"):
        robot.command(np.zeros(3), 1e-3)
    assert robot.time == 0.0


# A robot of one's own is looked at before it runs, and compared with its MuJoCo scene.


def task(model=None, pair=WALL, alpha=10.0, amplitude=0.02, ticks=1500, guess=START, **how):
    """Robot, controller and references of an arm that wipes a wall."""
    robot = robot_of(scene() if model is None else model, contacts=[pair])
    controller, X = ready(robot, pair, guess, **how)
    along = wiping(X, amplitude, alpha)
    return (robot, controller, [along(1e-3 * k) for k in range(ticks)])


def heavy(factor):
    model = scene()
    model.body_mass[:] *= factor
    model.body_inertia[:] *= factor
    model.actuator_ctrllimited[:] = 1
    model.actuator_ctrlrange[:] = (-40, 40)
    return model


NEAR = [0.3, 0.4, -1.2]


def short(limit):
    """The elbow's range ends so far beyond its position in contact."""
    model = scene()
    at = robot_of(model).touching(NEAR)[1]
    model.joint("elbow").range[:] = (at - limit, at + limit)
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


@parametrize("name", WRONG)
def test_what_is_wrong_is_found_before_it_runs(name):
    make, words = WRONG[name]
    found = osc.preflight(*task(**make()))
    kinds = {one.refused for one in found if words in one.text}
    assert kinds == {name not in ("tilted normal", "slow loop")}, found


def test_a_sound_task_is_passed_and_left_as_it_is():
    robot, controller, references = task()
    assert osc.preflight(robot, controller, iter(references)) == ()
    assert not controller.records.memory.ticked and robot.time == 0.0
    osc.run_loop(robot, controller, references)
    assert robot.truth().alpha[0] == approx(10.0, rel=0.02)


def test_a_joint_too_fast_is_named_with_its_time():
    robot, controller, references = task(amplitude=0.2, ticks=800)
    robot.chain.model.velocityLimit[:] = 0.5
    *others, one = osc.preflight(robot, controller, references)
    assert one.refused and "above its speed limit of 0.5" in one.text and "at t = 0." in one.text
    assert all("above safety.speed_ceiling" in other.text for other in others)


def test_a_controller_with_other_masses_is_found():
    robot, _, references = task()
    controller = osc.Controller(robot_of(heavy(1.3)).chain, [WALL], posture=robot.measure().q)
    found = [x for x in osc.preflight(robot, controller, references) if "weighs" in x.text]
    assert [(x.text.split(" weighs")[0], x.refused) for x in found] == [
        ("all that moves", False),
        ("what the wrist carries", False),
    ]


def off_the_wall(**how):
    """The robot at rest 20 mm before the wall, a controller that approaches it, and its pose."""
    robot = robot_of(scene())
    robot.contacts = [replace(WALL, point=[0.48, 0, 0.5])]
    return (robot, *ready(robot, life=osc.PhaseSettings(), **how))


def test_a_wrist_without_gravity_is_refused_at_the_door():
    robot, controller, X = off_the_wall()
    blind = SimpleNamespace(
        chain=robot.chain, measure=lambda: replace(robot.measure(), wrenches=np.full((1, 6), 1e-3))
    )
    for judged, shift, words in (
        (blind, 0.0, "without gravity"),
        (robot, 0.2, "0.2 m away from where it is"),
    ):
        goal = osc.pose_reference(X.translation + [0, 0, shift], X.rotation, alpha_d=[5.0])
        (one,) = osc.preflight(judged, controller, [goal])
        assert one.refused and words in one.text


def test_force_sensors_read_the_same_after_a_step_in_two_halves():
    """MuJoCo 3.5, below the lower bound, omits the contribution of velocities."""
    model = scene()
    whole, halves = mujoco.MjData(model), mujoco.MjData(model)
    for data in (whole, halves):
        data.qvel[:] = 1.0
    for _ in range(3):
        mujoco.mj_step(model, whole)
        mujoco.mj_step1(model, halves)
        mujoco.mj_step2(model, halves)
    assert largest(whole.sensordata) > 0.1
    assert_near(halves.sensordata, whole.sensordata, atol=1e-9)


def test_what_cannot_be_looked_at_is_refused():
    robot, controller, references = task()
    bad = [replace(references[0], alpha_d=np.zeros(2))]
    for words, given in {
        "its controller and references": (),
        "no references": (controller, []),
        "1 columns of N": (controller, bad),
    }.items():
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
    scene = osc.MujocoRobot.from_model(model, tip="hand").scene()
    for point, expected in (
        ([0, 0, 4.5], 0.5),
        ([0, 0, 3.7], -0.3),
        ([0, 0.9, 3], -0.1),
        ([3, 0, 0.2], 0.2),
        ([5, 0, 4.2], 0.2),
        ([3, 0, -0.4], -0.4),
        ([5, 0, 3.8], -0.2),
    ):
        assert scene.distance(np.array(point, dtype=float))[0] == approx(expected, abs=1e-5)
    assert scene.clearance() == (approx(1.9), "box")


# Pictures of a robot in a MuJoCo scene of one's own, and of recordings that it leaves.


@module_fixture
def recorded(tmp_path_factory):
    """A robot, its recording and the file of it."""
    robot = robot_of(scene(), locked={"grip": 0.02})
    controller, X = ready(robot)
    recorder = osc.Recorder(controller, robot)
    osc.run_loop(robot, controller, map(wiping(X), np.arange(0, 0.4, 1e-3)), recorder=recorder)
    file = tmp_path_factory.mktemp("own") / "own.npz"
    recorder.recording().save(file)
    return (robot, osc.Recording.load(file), file)


def test_the_picture_stands_where_mujoco_puts_the_shapes(recorded):
    robot, recording, _ = recorded
    model, shapes = read_picture(recording.meta["picture"])
    q = vector(0.7, -0.4, 1.1)
    robot.reset(q)
    robot.data.joint("grip").qpos[:] = 0.02
    mujoco.mj_forward(robot.model, robot.data)
    data = data_at(model, q)
    drawn = {True: [], False: []}
    for one in shapes.geometryObjects:
        X = data.oMi[one.parentJoint] * one.placement
        drawn[one.parentJoint > 0].append(X.translation)
    for name in ("upper", "lower", "tool", "wall"):
        away = drawn[name != "wall"] - robot.data.geom(name).xpos
        assert np.linalg.norm(away, axis=1).min() < 1e-6, name


def test_a_recording_carries_no_path_and_is_drawn(recorded, tmp_path):
    _, recording, file = recorded
    text = json.dumps(recording.meta)
    assert str(Path.cwd()) not in text and "/home" not in text and "/tmp" not in text
    page = tmp_path / "own.html"
    png = tmp_path / "own.png"
    done("view", file, "--html", page)
    assert "arms/arm/elbow" in page.read_text() or page.stat().st_size > 5e5
    done("view", file, "--png", png)
    assert pixels_of(Image.open(png)).reshape(-1, 3).std(axis=0).max() > 10.0


def test_a_viewer_takes_the_robot_and_its_recording(recorded, tmp_path):
    robot, recording, _ = recorded
    with osc.open_viewer(robot) as viewer:
        for tick in (0, 200):
            viewer._next_send = 0.0
            viewer.show(recording.at(tick))
        with Browser(viewer.url) as page:
            page.until("element('live').textContent === 'LIVE'")
            goal = recording["t"][200]
            page.until(f"Math.abs(player.time - {goal}) < 1e-6")
            pixels = page.picture(tmp_path / "live.png")[:600]
            assert pixels.std() > 10 and near(pixels, "#0072B2") > 20
            assert viewer.error is None and viewer.count_browsers() == 1
            viewer.close()
            page.until("element('live').textContent === 'ENDED'")


@parametrize(
    "damage",
    [
        lambda p: None,
        lambda p: p | {"joints": p["joints"][:1]},
        lambda p: p | {"shapes": [p["shapes"][0] | {"place": [0, 0, 0]}]},
        lambda p: p | {"shapes": [p["shapes"][0] | {"joint": 99}]},
        lambda p: p | {"shapes": [{**p["shapes"][0], "kind": 7, "corners": "???", "faces": ""}]},
    ],
)
def test_damaged_pictures_are_refused(recorded, damage, tmp_path):
    _, recording, _ = recorded
    file = tmp_path / "bad.npz"
    bad = {"picture": damage(recording.meta["picture"])}
    osc.Recording(recording.meta | bad, dict(recording.channels)).save(file)
    assert "picture" in refused("view", file, "--html", tmp_path / "page.html")


# Postures outside joint limits and wrists that read a wrong weight are found at the start ---------

DEGREES = np.degrees(START)


def limited():
    """The arm of `scene`, its joints limited to ±2 rad."""
    model = scene()
    for name in ("shoulder", "elbow", "wrist_pitch"):
        model.joint(name).range[:] = (-2.0, 2.0)
        model.joint(name).limited[:] = 1
    return robot_of(model)


@parametrize("door, out", {"reset": 3.0, "touching": 3.0, "posture": 200.0})
def test_postures_outside_the_limits_are_refused_with_numbers_and_cure(door, out):
    """The posture is a goal, which only wrong units bring this far out."""
    robot = limited()
    doors = {
        "reset": robot.reset,
        "touching": robot.touching,
        "posture": lambda q: osc.Controller(robot.chain, [WALL], posture=q),
    }
    words = rf"arm/elbow at {out:g} is outside its limits \[-2, 2\].* file"
    with invalid_input(words):
        doors[door]([0.3, out, -1.2])
    with invalid_input(r"look like degrees: give np.radians"):
        doors[door](DEGREES)
    doors[door](START)


@parametrize("sign", [-1.0, 1.0])
def test_a_posture_may_be_a_goal_beyond_the_limits_by_less_than_one_and_a_half_ranges(sign):
    chain = limited().chain
    near = [0.3, sign * 7.9, -1.2]
    far = [0.3, sign * 8.1, -1.2]
    assert osc.Controller(chain, [WALL], posture=near).settings.posture[1] == near[1]
    with invalid_input(r"posture: joint arm/elbow at .* is outside"):
        osc.Controller(chain, [WALL], posture=far)


def test_a_touching_posture_outside_the_limits_is_refused():
    far = limited()
    far.contacts = [osc.VertexOnFace([0, 0, 0], [0.1, 0, 0.5], [-1, 0, 0], name="behind")]
    with model_error(r"touching: joint .* is outside"):
        far.touching([1.9, 1.9, 0.0])


def test_a_controller_that_starts_outside_the_limits_holds_and_stops():
    robot = limited()
    q = np.array(START)
    controller = osc.Controller(robot.chain, [], posture=q)
    goal = osc.Reference(robot.chain.state(q).X_WO)
    read = unloaded(DEGREES, np.zeros(3))
    for _ in range(25):
        assert largest(held_tick(controller, "look like degrees", read, goal)) < 40.0
    assert controller.state is osc.SafetyState.SAFE_STOP
    controller.reset()
    ticked(controller, replace(read, q=q), goal)


def free_run(change, tick=lambda k, controller: None, ticks=300, **how):
    """Ticks `off_the_wall`, the wrist's readings changed."""
    robot, controller, X = off_the_wall(**how)
    rng = np.random.default_rng(1)
    for k in range(ticks):
        read = robot.measure()
        noise = rng.standard_normal((1, 6)) * np.repeat([0.3, 0.006], 3)
        wrench = change(read.wrenches, robot) + noise
        tau = controller.tick(replace(read, wrenches=wrench), osc.Reference(X, alpha_d=[5.0]))
        tick(k, controller)
        if controller.state is osc.SafetyState.SAFE_STOP:
            break
        robot.command(tau, controller.dt)
    return (controller, k)


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
