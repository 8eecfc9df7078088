"""Faces that move and turn: kinematics, plants, geometry, and the law, which alone has Φ_e."""

import copy
import pickle
from dataclasses import replace

import numpy as np
import pinocchio as pin
from complaints import contact_error, scenario_error
from numpy.random import default_rng
from numpy.testing import assert_array_equal
from pytest import mark
from rigs import assert_near, direction, displacement, largest, shift
from samples import aligned, parametrize
from scenario_runs import (
    assert_accurate,
    closed_force,
    rig_of,
    run_of,
    verdict_of,
)

import osc_contact as osc
from osc_contact.lab.plants.faces import Faces
from paper import variants
from paper.study import ticks

FACES = {
    face: [change.replace("ramp: 2 s", "ramp: 0.1 s") for change in changes]
    for face, changes in variants.FACES.items()
}
TURNING = FACES["turning conveyor"]
HINGE = FACES["hinge with spring"]
RIGID = ("plant.type=rigid", "plant.step=1 ms")


def times(count, start=1.0):
    """(count,) of ticks, s."""
    return start + 1e-3 * np.arange(count)


def on_the_move(rig, count=60, start=1.0):
    """A plant and a controller after so many ticks: faces swing, the object moves."""
    plant = rig.plant()
    controller = rig.controller()
    if count:
        osc.run_loop(plant, controller, rig.references.over(times(count, start)))
    return (plant, controller)


@parametrize("changes", FACES.values(), ids=FACES)
def test_contact_forces_are_the_commanded_ones_at_every_instant(changes):
    """The rigid plant has no Φ_e, only a cart in its equations; α = α_u and sensing are exact."""
    rig = rig_of("moving_face", *RIGID, *changes)
    plant, controller = on_the_move(rig)
    moved = 0.0
    for _, reference, truth in ticks(plant, controller, rig.references.over(times(20, 1.06))):
        assert_near(truth.alpha, controller.signals.alpha_u, rtol=1e-9)
        controller.force_integral = np.zeros(2)
        controller.tick(plant.measure(), reference)
        assert_near(controller.signals.alpha_meas, truth.alpha, rtol=1e-9)
        moved = max(moved, largest(plant.measure().touched.V_E))
    assert moved > 1e-3
    assert (largest(plant.measure().touched.V_E[:, 3:]) > 1e-2) == (changes in (TURNING, HINGE))


@parametrize("changes", [FACES["cart with spring"], HINGE], ids=["cart", "hinge"])
def test_a_free_face_takes_the_power_of_its_contact(changes):
    """½Iṡ² + ½ks² − (preload + weight) s grows by α NᵀV_e − cṡ²."""
    rig = rig_of("moving_face", *RIGID, "gains.force.rise=0 s", *changes)
    plant, controller = on_the_move(rig, 0)
    faces = plant.faces
    rail = faces.rails[0]
    (joint,) = rail.joints
    energy = []
    power = []
    load = rail.preload - 9.81 * rail.inertia * rail.direction[2]
    for *_, truth in ticks(plant, controller, rig.references.over(times(120))):
        s = faces.s[0][joint]
        rate = faces.rates[0][joint]
        V_e = rail.twist(faces.s[0], faces.rates[0], truth.X_WO.translation)
        N = rig.pairs[0].contact(truth.X_WO, truth.V_O, truth.X_WE[0]).N
        assert_near(N.T @ (truth.V_O - V_e), 0.0, atol=1e-12)
        power.append(truth.alpha[0] * (N.T @ V_e)[0] - rail.damping * rate**2)
        energy.append((rail.inertia * rate**2 + rail.stiffness * s**2) / 2 - load * s)
    power = np.array(power)
    assert_near(np.diff(energy), 1e-3 * (power[1:] + power[:-1]) / 2, atol=2e-6 * largest(power))
    assert largest(power) > 1e-3


H = 1e-4


def swinging(rng):
    """A rail with both joints, and s(t), its first and second derivative."""
    A = rng.standard_normal(2)
    w = rng.uniform(1, 3, 2)
    phase = rng.uniform(0, 6, 2)

    def motion(t):
        x = w * t + phase
        return (A * np.sin(x), A * w * np.cos(x), -A * w**2 * np.sin(x))

    return osc.Rail(direction(rng), direction(rng), rng.standard_normal(3), motion)


def placed(rail, t):
    s, rates, second = rail.motion(t)
    X = rail.pose(s)
    p = X.translation
    return (X, rail.twist(s, rates, p), rail.acceleration(s, rates, second, p))


def test_twist_and_acceleration_are_the_derivatives_of_the_pose():
    rng = default_rng(0)
    for _ in range(20):
        rail = swinging(rng)
        t = rng.uniform(0, 5)
        (X0, V0, _), (X, V, A), (X1, V1, _) = (placed(rail, t + dt) for dt in (-H, 0.0, H))
        assert_near(V, displacement(X0, X1) / (2 * H), atol=1e-5)
        assert_near(A, (V1 - V0) / (2 * H), atol=1e-5)
        (travel, angle), *_ = rail.motion(t)
        assert_near(X.rotation, pin.exp3(angle * rail.axis), atol=1e-12)
        hinge = rail.through + travel * rail.direction
        assert_near(X.act(rail.through), hinge, atol=1e-12)


@parametrize("face", [FACES["conveyor"], TURNING], ids=["conveyor", "turning"])
@parametrize("plant", ["rigid", "mujoco"])
def test_a_driven_face_is_where_its_signals_say(plant, face):
    rig = rig_of("moving_face", f"plant.type={plant}", *face)
    motion = rig.scenario.contacts[0].face.motion
    turn = motion.turn
    plant, _ = on_the_move(rig, 150, 0.0)
    angle = turn.signals[0].at(0.15) if turn else np.zeros(3)
    s = np.array([motion.signals[0].at(0.15), angle]).T
    hinge = [turn.axis, turn.through] if turn else np.zeros((2, 3))
    X, V, A = placed(osc.Rail(*np.array([motion.direction, *hinge]), lambda _: s), 0.15)
    touched = plant.measure().touched
    assert_near(touched.X_WE[0], X.homogeneous, atol=1e-7)
    assert_near(touched.V_E[0], V, atol=1e-5)
    assert_near(touched.A_E[0], A, atol=1e-7)
    assert_near(plant.truth().X_WE[0].homogeneous, touched.X_WE[0], atol=1e-5)
    assert_array_equal(touched.X_WE[1], np.eye(4))
    assert s[0, 0] > 1e-4 and (abs(s[1, 1]) > 1e-2) == (turn is not None)


def test_motions_are_evaluated_once_an_instant_and_anew_at_the_next():
    evaluated = []
    size = np.ones(2)

    def motion(t):
        evaluated.append(t)
        return (size * t, size, 0.0 * size)

    faces = Faces([osc.Rail(axis=[0, 0, 1], motion=motion), osc.Rail()], (0, 1, 0))
    for t in (0.0, 0.1, 0.1, 0.3, 0.1):
        faces.s[:] = 7.0  # a plant may have moved them meanwhile
        faces.drive(t)
        assert_array_equal([faces.s, faces.rates], [[[t, t], [7, 7]], [[1, 1], [0, 0]]])
    assert evaluated == [0.0, 0.1, 0.3, 0.1]
    faces.drive(0.0)
    size *= 2.0
    faces.reset()
    assert_array_equal(faces.rates[0], 2.0)
    assert not faces.s.any()


@parametrize("plant", ["rigid", "mujoco"])
@parametrize("face", [HINGE, TURNING], ids=["hinge", "turning"])
def test_readings_of_a_face_are_those_of_their_instant_whenever_they_are_looked_at(plant, face):
    plant, _ = on_the_move(rig_of("moving_face", f"plant.type={plant}", *face), 100)
    known = plant.measure().touched
    expected = [known.X_WE.copy(), known.V_E.copy(), known.A_E.copy()]
    read, copied, changed = (plant.measure().touched for _ in range(3))
    plant.command(np.zeros(plant.chain.n_a), 4e-3)
    now = plant.measure().touched
    copies = (pickle.loads(pickle.dumps(copied)), copy.deepcopy(read), replace(changed))
    for old in (read, known, *copies):
        for x, y in zip((old.X_WE, old.V_E, old.A_E), expected, strict=True):
            assert_array_equal(x, y)
    assert largest(now.X_WE - read.X_WE) > 1e-6 and largest(now.V_E - read.V_E) > 1e-6
    assert_array_equal(replace(now, V_E=0.0 * now.V_E).X_WE, now.X_WE)


def test_signals_of_a_workcell_are_evaluated_once_a_step():
    commands = 3
    rig = rig_of("workcell")
    plant = rig.plant()
    robot = rig.robot(plant, rig.controller())
    evaluated = []
    faces = plant.plant.faces
    for i, motion in faces.driven.items():
        faces.driven[i] = lambda t, motion=motion: evaluated.append(t) or motion(t)
    for _ in range(commands):
        robot.measure()
        robot.command(np.zeros(plant.plant.chain.n_a), 1e-3)
    robot.measure()
    assert len(evaluated) == 2 * 4 * commands
    assert len(set(evaluated)) == 4 * commands


@parametrize(
    "signals, words",
    {
        "[{type: sine, amplitude: 30 mm, frequency: 1 Hz}]": r"left_end.*0.188\d* m/s.*ramp",
        "[{type: constant, value: 0 mm}], turn: {axis: [0, 1, 0], through: [0, 0, 0], "
        "signals: [{type: constant, value: 1 deg}]}": r"left_end.*0\.0174\d* rad",
    },
)
def test_a_driven_face_must_start_at_the_contact(signals, words):
    motion = f"{{type: conveyor, direction: [1, 0, 0], signals: {signals}}}"
    with scenario_error(words):
        rig_of("moving_face", f"contacts.left_end.face.motion={motion}").plant()


@mark.slow
def test_projected_power_vanishes_and_total_power_does_not_while_a_face_turns():
    recording = run_of("moving_face", *TURNING, "plant.step=1 ms", plant="rigid", duration=1.3)
    verdict = osc.metrics(recording)
    assert verdict["power"]["ratio"] <= 1e-10 and verdict["power"]["total_rms_W"] > 0.02
    turned = [pin.log3(pin.Quaternion(q).matrix()) for q in recording["face_pose"][::100, 0, 3:]]
    assert np.ptp(turned, axis=0).max() > np.deg2rad(3.0)


@parametrize("face", [TURNING, HINGE], ids=["turning", "hinge"])
def test_mujoco_keeps_force_and_contact_on_a_face_that_turns(face):
    assert closed_force(verdict_of("moving_face", *face, duration=2.0)) < 0.005


def test_detected_contacts_keep_the_task():
    """The controller reads N off the geometry while the object slides by a third of its stroke."""
    rig = rig_of("two_contact_rod", "control.contacts=detected", "duration=1.6")
    tracked = rig.controller().contacts
    assert all(pair.name == own.name for pair, own in aligned(tracked, rig.pairs))
    verdict = verdict_of(rig.scenario)
    assert_accurate(verdict)
    assert verdict["motion"]["rms_error_m"] < 1e-4


def test_tracked_contacts_are_looked_up_again_after_a_while_and_agree_with_the_declared_ones():
    """Also while the face turns."""
    rig = rig_of("two_contact_rod", "control.contacts=detected")
    pair = rig.pairs[0]
    tracked = rig.controlled_pairs()[0]
    X = rig.state.X_WO
    rng = default_rng(3)
    seen = []
    for k in range(50):
        along = 2e-4 * k * np.cross(pair.normal, [0.0, 0.0, 1.0])
        X_WE = pin.SE3(pin.exp3(0.01 * k * direction(rng)), rng.standard_normal(3))
        V_O, V_E = rng.standard_normal((2, 6))
        moved = X_WE * shift(along) * X
        ours, truth = (one.contact(moved, V_O, X_WE, V_E) for one in (tracked, pair))
        assert_near(ours.N, truth.N, atol=1e-9)
        assert_near(ours.n_gamma, truth.n_gamma, atol=1e-9)
        assert_near(tracked.gaps(moved, X_WE), pair.gaps(moved, X_WE), atol=1e-9)
        seen.append(tracked.lookups)
    assert seen[0] == 1 and 2 < seen[-1] < 10
    away = shift(0.1 * pair.normal) * X
    assert tracked.contact(away, V_O).r == 1  # the last one found stays in force
    fresh = rig.controlled_pairs()[0]
    with contact_error("nothing touches"):
        fresh.contact(away, V_O)
