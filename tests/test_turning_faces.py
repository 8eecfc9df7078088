"""Faces that turn: their kinematics, N while they turn, plants, power, geometry."""

import numpy as np
import pinocchio as pin
from complaints import scenario_error
from numpy.random import default_rng
from numpy.testing import assert_allclose
from pytest import mark
from rigs import largest, refused
from samples import parametrize
from scenario_runs import run_of, verdict_of
from test_moving_face import HINGE, TURNING, on_the_move, rig_of

import osc_contact as osc
from osc_contact.dynamics.environment import Hinge
from osc_contact.plants.faces import Rail
from osc_contact.spatial import carry_twist

H = 1e-4


def unit(rng):
    x = rng.standard_normal(3)
    return x / np.linalg.norm(x)


def swinging(rng):
    """A rail with both joints, and s(t), its first and second derivative."""
    A = rng.standard_normal(2)
    w = rng.uniform(1, 3, 2)
    phase = rng.uniform(0, 6, 2)

    def motion(t):
        x = w * t + phase
        return A * np.sin(x), A * w * np.cos(x), -A * w**2 * np.sin(x)

    return Rail(unit(rng), unit(rng), rng.standard_normal(3), motion)


def placed(rail, t):
    s, rates, second = rail.motion(t)
    X = rail.pose(s)
    p = X.translation
    return X, rail.twist(s, rates, p), rail.acceleration(s, rates, second, p)


def test_twist_and_acceleration_are_the_derivatives_of_the_pose():
    rng = default_rng(0)
    for _ in range(20):
        rail = swinging(rng)
        t = rng.uniform(0, 5)
        (X0, V0, _), (X, V, A), (X1, V1, _) = (placed(rail, t + dt) for dt in (-H, 0.0, H))
        spin = (pin.log3(X1.rotation @ X.rotation.T) - pin.log3(X0.rotation @ X.rotation.T)) / 2
        assert_allclose(V[:3], (X1.translation - X0.translation) / (2 * H), atol=1e-5)
        assert_allclose(V[3:], spin / H, atol=1e-5)
        assert_allclose(A, (V1 - V0) / (2 * H), atol=1e-5)
        assert_allclose(rail.pose(np.zeros(2)).homogeneous, np.eye(4), atol=1e-15)


@parametrize("plant", ["rigid", "mujoco"])
def test_a_turning_face_is_where_its_signals_say(plant):
    rig = rig_of(f"plant.type={plant}", *TURNING)
    motion = rig.scenario.contacts[0].face.motion
    plant, _ = on_the_move(rig, 150)
    s, ds, _ = motion.signals[0].at(0.15)
    angle, rate_, second = motion.turn.signals[0].at(0.15)
    axis = np.array(motion.turn.axis)
    through = np.array(motion.turn.through)
    touched = plant.measure().touched
    truth = plant.truth()
    X = pin.SE3(touched.X_WE[0])
    assert_allclose(X.rotation, pin.exp3(angle * axis), atol=1e-7)
    carried = through + s * np.array(motion.direction)
    assert_allclose(X.act(through), carried, atol=1e-7)
    assert_allclose(touched.V_E[0, 3:], axis * rate_, atol=1e-5)
    assert_allclose(touched.A_E[0, 3:], axis * second, atol=1e-12)
    of_hinge = carry_twist(touched.V_E[0], X.translation, carried)
    assert_allclose(of_hinge[:3], ds * np.array(motion.direction), atol=1e-5)
    assert_allclose(truth.X_WE[0].homogeneous, X.homogeneous, atol=1e-5)
    assert abs(rate_) > 1e-2 and abs(s) > 1e-4


def test_a_hinged_face_takes_the_power_of_its_contact():
    """½Iθ̇² + ½kθ² − preload θ grows by α NᵀV_e − cθ̇²: the ledger of a contact that moves."""
    rig = rig_of("plant.type=rigid", "plant.step=1 ms", "gains.force.rise=0 s", *HINGE)
    rail = rig.plant().faces.rails[0]
    plant, controller = on_the_move(rig, 0)
    energy = []
    power = []
    for k in range(120):
        tau = controller.tick(plant.measure(), rig.references.at(1.0 + 1e-3 * k))
        plant.hold(tau)
        touched = plant.measure().touched
        truth = plant.truth()
        angle = pin.log3(touched.X_WE[0, :3, :3]) @ rail.axis
        turn = touched.V_E[0, 3:] @ rail.axis
        V_e = carry_twist(touched.V_E[0], touched.X_WE[0, :3, 3], truth.X_WO.translation)
        contact = rig.pairs[0].contact(truth.X_WO, truth.V_O, truth.X_WE[0], touched.V_E[0])
        assert_allclose(contact.N.T @ (truth.V_O - V_e), 0.0, atol=1e-12)
        power.append(truth.alpha[0] * (contact.N.T @ V_e)[0] - rail.damping * turn**2)
        stored = rail.stiffness * angle**2 / 2 - rail.preload * angle
        energy.append(rail.inertia * turn**2 / 2 + stored)
        plant.command(tau, 1e-3)
    power = np.array(power)
    energy = np.array(energy)
    assert_allclose(
        np.diff(energy), 1e-3 * (power[1:] + power[:-1]) / 2, atol=2e-3 * largest(power) * 1e-3
    )
    assert largest(power) > 1e-3


@mark.slow
def test_projected_power_vanishes_and_total_power_does_not_while_a_face_turns():
    recording = run_of("moving_face", *TURNING, "plant.step=1 ms", plant="rigid", duration=1.3)
    verdict = osc.metrics(recording)
    assert verdict["power"]["ratio"] <= 1e-10 and verdict["power"]["total_rms_W"] > 0.02
    turned = [pin.log3(pin.Quaternion(q).matrix()) for q in recording["face_pose"][::100, 0, 3:]]
    assert np.ptp(turned, axis=0).max() > np.deg2rad(3.0)


@parametrize("face", [TURNING, HINGE], ids=["turning", "hinge"])
def test_mujoco_keeps_force_and_contact_on_a_face_that_turns(face):
    verdict = verdict_of("moving_face", *face, duration=2.0)
    for force in verdict["force"].values():
        assert force["rms_error_rel"] < 0.005
    assert set(verdict["contact_fraction"].values()) == {1.0}


def test_a_turned_face_is_found_by_its_geometry_where_it_is():
    rig = rig_of(*TURNING)
    rng = default_rng(3)
    pair = rig.pairs[0]
    rail = rig.plant().faces.rails[0]
    tracked = rig_of("control.contacts=detected", *TURNING).controlled_pairs()[0]
    X_WO = rig.state().X_WO
    for angle in np.deg2rad([0.0, 2.0, 5.0, -5.0]):
        X_WE = rail.pose(np.array([0.01, angle]))
        V_O, V_E = rng.standard_normal((2, 6))
        moved = X_WO.copy()  # back onto the face, along its normal
        moved.translation = X_WO.translation + pair.gaps(X_WO, X_WE)[0] * pair.direction(X_WE)
        ours, declared = (p.contact(moved, V_O, X_WE, V_E) for p in (tracked, pair))
        assert_allclose(ours.N, declared.N, atol=1e-9)
        assert_allclose(ours.n_gamma, declared.n_gamma, atol=1e-9)
    assert tracked.lookups > 2


def test_a_turn_must_start_at_the_contact():
    turn = "{axis: [0, 1, 0], through: [0, 0, 0], signals: [{type: constant, value: 1 deg}]}"
    still = "[{type: constant, value: 0 mm}]"
    with scenario_error(r"left_end.*0\.0174\d* rad"):
        rig_of(
            "contacts.left_end.face.motion="
            f"{{type: conveyor, direction: [1, 0, 0], signals: {still}, turn: {turn}}}"
        ).plant()


@parametrize(
    ("change", "said"),
    [
        ({"axis": [0, 0, 0]}, "hinge.axis is zero"),
        ({"inertia": 0.0}, "hinge.inertia = 0"),
        ({"damping": -1.0}, "hinge.damping"),
        ({"through": [0, np.nan, 0]}, "hinge.through"),
    ],
)
def test_impossible_hinges_are_refused(change, said):
    given = {"axis": [0, 0, 1], "through": [0, 0, 0], "inertia": 1.0} | change
    with refused(said):
        Hinge(**given)
