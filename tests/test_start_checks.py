"""`run_loop` compares robot, controller and references before the first command."""

import logging
from dataclasses import replace
from itertools import count, repeat
from types import SimpleNamespace

import mujoco
import numpy as np
import pinocchio as pin
from complaints import invalid_input
from pytest import approx
from rigs import placed
from samples import module_fixture, parametrize
from scenario_runs import rig_of

import osc_contact as osc
from osc_contact.control.start_check import is_clear

RIGID = ("two_contact_rod", "plant.type=rigid", "plant.step=1 ms")
LOGGER = "osc_contact.preflight"


class Robot:
    """A driver: a plant plays the machine, and nothing is known of what stands around it."""

    def __init__(self, rig):
        self._plant = rig.plant()
        self.measure = self._plant.measure
        self.sent = 0
        self.stops = []

    def command(self, tau, duration):
        self.sent += 1
        self._plant.command(tau, duration)

    def stop(self, reason=""):
        self.stops.append(reason)


@module_fixture
def rig():
    return rig_of(*RIGID)


def plan(rig, ticks=20):
    return list(rig.references.each(ticks, 1e-3))


def refuse(rig, references, words):
    """Robot that a loop with these references leaves, refused with these words."""
    robot = Robot(rig)
    with invalid_input(words):
        osc.run_loop(robot, rig.controller(), references)
    assert robot.sent == 0
    return robot


def test_named_contacts_are_checked_set_by_set(rig):
    """Forces of contacts that are not active do not count; a short set is found."""
    references = [replace(one, active=np.ones(2)) for one in plan(rig, 3000)]
    hard = [replace(one, alpha_d=np.full(2, 190.0)) for one in references]
    for k, one in enumerate(hard):
        one.active[(k // 7) % 2] = 0.0
    controller = rig.controller().with_safety(
        rig.safety.replaced(contact_ceiling=300.0, wrist_ceiling=300.0)
    )
    sentences = [one.text for one in osc.preflight(Robot(rig), controller, hard)]
    assert not any("sum of all" in text for text in sentences)
    both = hard[:1500] + [replace(hard[0], active=np.ones(2))] + hard[1500:]
    (found,) = [
        one.text for one in osc.preflight(Robot(rig), controller, both) if "sum of all" in one.text
    ]
    assert "at t = 1.5 s, above safety.wrist_ceiling" in found


def test_what_is_refused_ends_the_loop_before_the_first_command_and_stops_the_robot(rig):
    bad = [replace(one, alpha_d=-one.alpha_d) for one in plan(rig)]
    robot = refuse(rig, bad, r"cannot pull(.|\n)*check=False leaves it out")
    (reason,) = robot.stops
    assert reason.startswith("InvalidInputError: alpha_d of left_end is")


def test_a_loop_that_is_not_checked_runs_all_the_same(rig):
    robot = Robot(rig)
    bad = [replace(one, alpha_d=-one.alpha_d) for one in plan(rig)]
    assert osc.run_loop(robot, rig.controller(), bad, check=False).ticks == robot.sent == 20


def test_a_sequence_is_compared_to_its_end_and_an_iterator_at_its_beginning(rig, caplog):
    late = plan(rig)
    late[15] = replace(late[15], alpha_d=1e4 * late[15].alpha_d)
    refuse(rig, late, "at t = 0.015 s")
    robot = Robot(rig)
    with caplog.at_level(logging.INFO, LOGGER):
        osc.run_loop(robot, rig.controller(), iter(late))
    assert robot.sent == 20
    assert "an iterator: only the first of them is checked" in caplog.text
    refuse(rig, iter([replace(late[0], alpha_d=[1e4, 1.0])]), "force_range")


def test_no_reference_of_an_endless_generator_is_lost(rig):
    """Also none is taken before it is due: a generator may look at the controller."""
    taken = []
    controller = rig.controller()
    first = plan(rig, 1)[0]

    def goals():
        for k in count():
            taken.append((k, int(controller.records.memory.ticked)))
            if k == 5:
                return
            yield first

    robot = Robot(rig)
    assert osc.run_loop(robot, controller, goals()).ticks == robot.sent == 5
    assert taken == [(k, k) for k in range(6)]


def test_references_that_are_none_are_refused(rig):
    one = plan(rig, 1)[0]
    refuse(rig, [], "there are no references.* only once")
    refuse(rig, iter(()), "there are no references")
    refuse(rig, one, r"references is Reference.*itertools.repeat\(reference, ticks\)")
    refuse(rig, [one, one.X_WD], r"reference 1 is SE3.*give osc.Reference\(X_WD")
    refuse(rig, [replace(one, alpha_d=[1.0])], "the contacts have 2 columns of N; give one")


def test_a_first_reading_that_is_missing_is_waited_for(rig):
    robot = Robot(rig)
    read = robot.measure
    missing = iter([True] * 3)
    robot.measure = lambda: replace(
        read(), wrenches=np.full((2, 6), np.nan if next(missing, False) else read().wrenches)
    )
    assert osc.run_loop(robot, rig.controller(), plan(rig)).ticks == 20
    robot.measure = lambda: replace(read(), q=np.full(10, np.nan))
    with invalid_input("q"):
        osc.run_loop(robot, rig.controller(), plan(rig))


def test_a_controller_that_has_stopped_is_refused(rig):
    controller = rig.controller()
    robot = Robot(rig)
    blind = replace(robot.measure(), wrenches=np.full((2, 6), np.nan))
    for _ in range(60):
        controller.tick(blind, plan(rig, 1)[0])
    assert controller.state is osc.SafetyState.SAFE_STOP
    with invalid_input(r"stopped, until reset\(\) is called"):
        osc.run_loop(robot, controller, plan(rig))


def test_a_controller_of_ones_own_and_shadow_mode_are_not_compared():
    class Own:
        dt = 1e-3

        def tick(self, measurement, reference):
            return np.zeros(8)

    robot = Robot(rig_of(*RIGID))
    assert osc.run_loop(robot, Own(), repeat("any reference", 3)).ticks == 3


# --- what V_D and X_WD say of one another ---------------------------------------------------------


def circle(X, dt, ticks, scale=1.0):
    """A circle of 20 mm in 2 s, along one point of a free object."""
    w, r = np.pi, 0.02
    for k in range(ticks):
        c, s = np.cos(w * k * dt), np.sin(w * k * dt)
        yield osc.pose_reference(
            X.translation + [0, r * (1 - c), r * s],
            X.rotation,
            velocity=[0, scale * r * w * s, scale * r * w * c],
        )


def found(references, dt=1e-3):
    rig = rig_of("panda_edge")
    controller = osc.Controller(rig.chain, [], rig.gains, dt=dt, posture=rig.q_contact)
    return osc.preflight(rig.plant(), controller, references)


@parametrize(
    "spacing, dt, kind",
    [
        (1e-3, 1e-3, None),
        (1e-3, 1.07e-3, None),
        (1e-3, 1.15e-3, "doubtful"),
        (1e-3, 1.6e-3, "refused"),
        (1e-3, 1e-2, "refused"),
    ],
)
def test_references_are_spaced_by_the_control_period(spacing, dt, kind):
    X = rig_of("panda_edge").state.X_WO
    kinds = {
        ("doubtful", "refused")[one.refused]: one.text
        for one in found(list(circle(X, spacing, 1000)), dt)
        if "references seem to be spaced" in one.text
    }
    assert list(kinds) == [kind] * (kind is not None)
    if kind:
        assert f"spaced {1e3 * spacing:.3g} ms" in kinds[kind]


def test_velocities_in_another_unit_and_none_at_all():
    X = rig_of("panda_edge").state.X_WO
    (one,) = found(list(circle(X, 1e-3, 1000, 1e3)))
    assert one.refused and "X_WD moves by 0.001 times V_D" in one.text
    (one,) = found(list(circle(X, 1e-3, 1000, 0.0)))
    assert not one.refused and "V_D is zero while X_WD moves at up to 0.0628 m/s" in one.text
    gains = rig_of("panda_edge").gains.motion
    behind = 0.02 * np.pi * gains.damping / gains.stiffness
    assert f"{behind:.3g} m behind" in one.text


def test_a_velocity_at_right_angles_to_the_motion_is_another_one_and_not_left_out():
    X = rig_of("panda_edge").state.X_WO
    across = np.eye(6)[1] * 0.1  # m/s along y
    motion = [pin.SE3(X.rotation, X.translation + [1e-4 * k, 0.0, 0.0]) for k in range(500)]
    (one,) = found([osc.Reference(pose, across, np.zeros(6)) for pose in motion])
    assert "V_D is up to 0.141 m/s off the rate of X_WD" in one.text


def test_a_step_of_the_pose_is_no_speed():
    X = rig_of("panda_edge").state.X_WO
    aside = placed(0, 0, 0.01) * X
    steps = [osc.Reference(X)] * 500 + [osc.Reference(aside)] * 500
    assert [one.text for one in found(steps) if "V_D" in one.text] == []


# --- scenes ---------------------------------------------------------------------------------------


def forearm(actuator):
    """An arm whose tip is taken on its forearm; the wrist beyond has this actuator."""
    return mujoco.MjModel.from_xml_string(f"""
    <mujoco><option timestep="0.0005"/>
    <default><joint axis="0 1 0" damping="0.5" armature="0.1"/></default>
    <worldbody><body pos="0 0 0.5">
      <joint name="shoulder"/> <geom type="capsule" fromto="0 0 0 0.4 0 0" size="0.03" mass="3"/>
      <body pos="0.4 0 0">
        <joint name="elbow"/> <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.03" mass="2"/>
        <site name="inner" pos="0.3 0 0"/>
        <body pos="0.3 0 0"><joint name="wrist"/><geom size="0.04" pos="0.1 0 0" mass="1.5"/></body>
      </body>
    </body></worldbody>
    <actuator><motor joint="shoulder"/><motor joint="elbow"/>{actuator}</actuator>
    </mujoco>""")


@parametrize(
    "actuator, held",
    {
        '<motor joint="wrist"/>': False,
        "": False,
        '<velocity joint="wrist" kv="9"/>': False,
        '<position joint="wrist" kp="500"/>': True,
    },
)
def test_a_tip_on_an_inner_body_is_refused_unless_what_is_beyond_is_held(actuator, held):
    robot = osc.MujocoRobot.from_model(forearm(actuator), tip="inner")
    q = np.array([0.3, 0.6])
    robot.reset(q)
    controller = osc.Controller(robot.chain, [], posture=q)
    goals = [osc.Reference(robot.chain.state(q).X_WO)] * 100
    assert robot.scene().loose == ({} if held else {"wrist": approx(1.5)})
    if held:
        assert osc.run_loop(robot, controller, goals).ticks == 100
        return
    with invalid_input("'wrist' moves 1.5 kg beyond the tip, 23% .* is the tip on an inner body"):
        osc.run_loop(robot, controller, goals)
    assert robot.time == 0.0


def test_a_robot_of_ones_own_answers_for_its_scene(rig):
    """`scene` is all it needs: no plant of the package stands behind it."""

    class Wall:
        moved_mass = rig.chain.moved_mass
        carried_mass = rig.chain.outboard_mass
        tool_touches = True
        loose = {}  # noqa: RUF012

        def distance(self, point):
            return (0.012, "table")

        def clearance(self):
            return (0.0, "table")

        def require_period(self, duration):
            if duration < 2e-3:
                raise osc.PlantError("it takes 2 ms; give dt=0.002")

    robot = Robot(rig)
    robot.scene = Wall
    with invalid_input(r"give dt=0.002\n(.|\n)*'left_end' .* 12 mm before the nearest geom, 'tab"):
        osc.run_loop(robot, rig.controller(), plan(rig))


ON_ITS_AXIS = """<mujoco><option timestep="0.0005"/>
  <worldbody><body><joint name="turn"/><geom size="0.05"/><site name="tip"/></body></worldbody>
  <actuator><motor joint="turn"/></actuator></mujoco>"""


def test_a_tip_on_the_axis_of_its_joint_reaches_where_it_is():
    """The stretched arm reaches 0 m, and a ratio to that was no number."""
    model = mujoco.MjModel.from_xml_string(ON_ITS_AXIS)
    robot = osc.MujocoRobot.from_model(model, tip="tip")
    X = robot.chain.state(np.zeros(1)).X_WO
    controller = osc.Controller(robot.chain, [])
    assert osc.preflight(robot, controller, [osc.Reference(X)] * 5) == ()
    beside = [osc.Reference(X)] * 5 + [osc.Reference(placed(2e-3) * X)] * 5
    texts = [one.text for one in osc.preflight(robot, controller, beside) if one.refused]
    assert any("the stretched arm reaches 0 m" in text for text in texts), texts


def test_a_sequence_of_a_hundred_thousand_is_compared_to_its_end():
    rig = rig_of("panda_edge")
    controller = osc.Controller(rig.chain, [], rig.gains, posture=rig.q_contact)
    goals = list(circle(rig.state.X_WO, 1e-3, 2000)) * 50
    assert osc.preflight(rig.plant(), controller, goals) == ()
    goals[-1] = osc.Reference(placed(0, 5.0, 0) * rig.state.X_WO)
    (one,) = osc.preflight(rig.plant(), controller, goals)
    assert one.refused and "from the base of arm" in one.text and "at t = 100 s" in one.text


def clear_at(pair, xyz, rpy=(0.0, 0.0, 0.0)):
    """Whether a contact counts as open with the object at a place (m) and angles (rad)."""
    pose = pin.SE3(pin.rpy.rpyToMatrix(*rpy), np.array(xyz)).homogeneous
    bodies = SimpleNamespace(motion=np.zeros((1, 28)))
    work = SimpleNamespace(X_WO=pose, bodies=bodies, moving=0)
    return is_clear(SimpleNamespace(contacts=[pair]), SimpleNamespace(work=work))


def test_a_ball_pressed_into_a_soft_face_is_not_clear_of_it():
    ball = osc.SphereOnPlane([0, 0, 0], 0.01, [0, 0, 0], [0, 0, 1])
    assert clear_at(ball, [0, 0, 0.012])
    assert not clear_at(ball, [0, 0, 0.01])
    assert not clear_at(ball, [0, 0, 0.005])  # 5 mm deep, with its contact force


def test_a_hinge_off_its_axis_to_either_side_is_clear():
    hinge = osc.Revolute([0, 0, 0], axis=[0, 0, 1])
    for side in (-1.0, 1.0):
        place = [side * 0.01, side * 0.01, side * 0.01]
        assert clear_at(hinge, place, [side * 0.1, side * 0.1, 0.0])
    assert not clear_at(hinge, [0, 0, 0])
