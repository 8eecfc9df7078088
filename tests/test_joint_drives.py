"""Flexible joints, motors and joint friction in MuJoCo, and the loop that makes up for them."""

from contextlib import suppress

import mujoco
import numpy as np
from complaints import invalid_input, plant_error, scenario_error
from numpy.linalg import cholesky, eigh, solve
from numpy.random import default_rng
from numpy.testing import assert_array_equal
from pytest import approx
from rigs import assert_near, largest, vector
from samples import first, parametrize
from scenario_runs import closed_force, rig_of, verdict_of, worst_force

import osc_contact as osc
from benchmarks.random_tasks import draw
from osc_contact.control.joint_torque import JointTorqueLoop
from osc_contact.dynamics.chain_state import joint_inertias, modes, stiffness_for
from osc_contact.lab.plants.joint_drives import FlexibleJoints, Motors, set_dry_friction
from osc_contact.lab.rig.hardware import drives
from osc_contact.settings.control import JointTorqueSpec

FLEXIBLE = "plant.flexible_joints={frequency: 5 Hz}"
LOOP = "control.joint_torque={rate: 4 kHz}"


def free_rig(*changes):
    """Rig without faces."""
    return rig_of("two_contact_rod", "contacts=[]", "force={}", "motion=[]", *changes)


# --- the plant ------------------------------------------------------------------------------------


def test_the_motor_obeys_spongs_equation():
    """J_m θ̈ = u − τ, from MuJoCo's own accelerations, at speed."""
    rig = free_rig(FLEXIBLE)
    plant = rig.plant()
    rng = default_rng(0)
    J = plant.drives.flexible.motor_inertia
    for _ in range(20):
        tau = 0.2 * rig.chain.tau_max * rng.uniform(-1, 1, 8) * np.tile([1, 1, 0.1, 0.1], 2)
        plant.command(tau, 2e-3)
        plant._mj.mj_forward(plant.model, plant.data)
        theta_dd = plant.data.qacc[plant._v[rig.chain.actuated]]
        assert_near(J * theta_dd, tau - plant.measure().joint_torques, atol=1e-6 * largest(tau))


def test_a_held_rig_starts_with_wound_up_springs_at_the_same_pose():
    rig = rig_of("two_contact_rod", FLEXIBLE)
    plant = rig.plant()
    tau = vector(-3.9, -1.1, -15.0, 0.3, 3.7, -0.2, -17.7, 0.1)
    plant.hold(tau)
    read = plant.measure()
    assert_near(read.joint_torques, tau, rtol=1e-9)
    assert_near(read.q, rig.q_start, atol=1e-12)
    assert_array_equal(read.v, 0.0)


def test_with_held_motors_mujoco_swings_at_the_frequencies_of_the_closed_chain():
    """The desired first mode is the one that comes out of another engine."""
    held = "plant.flexible_joints={frequency: 4 Hz, damping_ratio: 0, motor_inertia: 1e6}"
    rig = free_rig(held, "squeeze=0 N")  # a squeezed linkage is softer
    plant = rig.plant()
    state = rig.state
    K = plant.drives.flexible.stiffness
    driven = rig.chain.actuated
    assert modes(state, driven, K)[0] == approx(4.0, rel=1e-9)
    W = state.W[driven]
    L = cholesky(state.Lambda_S)
    _, shapes = eigh(solve(L, solve(L, W.T @ (K[:, None] * W)).T))
    velocity = state.W @ solve(L.T, shapes[:, 0])
    velocity *= 0.02 / largest(velocity)
    plant.hold(holding(rig))
    passive = np.setdiff1d(np.arange(rig.chain.nq), driven)
    for joints, which in ((plant._spring_v, driven), (plant._v[passive], passive)):
        plant.data.qvel[joints] = velocity[which]
    wound = []
    for _ in range(2000):
        plant.command(plant.data.ctrl.copy(), 1e-3)
        wound.append(plant.data.qpos[plant._springs[0]])
    wound = np.array(wound) - np.mean(wound)
    up = np.flatnonzero((wound[:-1] < 0) & (wound[1:] >= 0))
    zeros = up + wound[up] / (wound[up] - wound[up + 1])
    assert 1e3 / np.diff(zeros).mean() == approx(4.0, rel=0.01)


def holding(rig):
    return rig.controller().tick(rig.at_start(rig.plant().measure()), rig.references.at(0.0))


def test_springs_share_the_inertias_of_the_joints():
    rig = rig_of()
    state = rig.state
    driven = rig.chain.actuated
    own = joint_inertias(state, driven)
    assert own.min() > 0.01  # the wrist's turn too moves half a rod
    K = stiffness_for(state, driven, 7.0)
    assert_near(K / own, K[0] / own[0], rtol=1e-12)
    assert_near(modes(state, driven, 4 * K), 2 * modes(state, driven, K), rtol=1e-12)


@parametrize("inertia", [2e-4, 2.0])
def test_joint_friction_is_dry_for_light_joints_too(inertia):
    """I v̇ = τ − F sign v: at rest below F, and above it 5 % of F are left to accelerate."""
    spec = mujoco.MjSpec()
    spec.option.timestep = 2.5e-4
    spec.option.gravity = np.zeros(3)
    body = spec.worldbody.add_body(mass=1.0, inertia=np.full(3, inertia))
    set_dry_friction(body.add_joint(type=mujoco.mjtJoint.mjJNT_HINGE), 1.0, spec.option.timestep)
    model = spec.compile()
    for torque, speed in ((0.95, 0.0), (1.05, 0.05 * 0.1 / inertia)):
        data = mujoco.MjData(model)
        data.qfrc_applied[:] = torque
        mujoco.mj_step(model, data, 400)
        assert_near(data.qvel, speed, atol=1e-4 * 0.1 / inertia)


def test_errors_of_motors_deflect_no_spring_before_the_start():
    """A light wrist would be thrown by them at the first instant."""
    plant = rig_of("two_contact_rod", FLEXIBLE, "plant.motors={bias: 0.01, ripple: 0.01}").plant()
    tau = vector(-3.9, -1.1, -15.0, 0.3, 3.7, -0.2, -17.7, 0.1)
    plant.hold(tau)
    assert_near(plant.measure().joint_torques, tau, rtol=1e-9)


def test_motors_have_the_joint_friction_and_springs_have_none():
    rig = free_rig(FLEXIBLE, "plant.joint_friction=0.05")
    plant = rig.plant()
    friction = plant.model.dof_frictionloss
    assert_near(friction[plant._v[rig.chain.actuated]], 0.05 * rig.chain.tau_max)
    assert not friction[plant._spring_v].any()


def test_motor_errors_are_those_drawn():
    motors, again = (
        Motors.drawn(vector(60.0, 200.0), np.array([False, True]), 0.01, 0.005, default_rng(3))
        for _ in range(2)
    )
    assert_near(np.abs(motors.bias), [0.6, 2.0])
    turn = np.linspace(0, 2 * np.pi, 1000)
    error = np.array([motors.torque(np.zeros(2), vector(x, x * 0.01)) for x in turn])
    assert_near(np.ptp(error, axis=0), [2 * 0.3, 2 * 1.0], rtol=1e-3)
    assert_array_equal(motors.phase, again.phase)


def test_imperfect_motors_reach_the_stiff_joint():
    rig = rig_of("two_contact_rod", "plant.motors={bias: 0.01}")
    plant = rig.plant(seed=4)
    plant.hold(np.zeros(8))
    assert_near(np.abs(plant.measure().joint_torques), 0.01 * rig.chain.tau_max)


def test_springs_by_number():
    text = "plant.flexible_joints={stiffness: {left: [1e3, 500, 2e3, 30], right: [1, 2, 3, 4]}, "
    rig = rig_of(
        "two_contact_rod",
        text + "motor_inertia: {left: [1, 1, 1, 1], right: [0.1, 0.1, 0.1, 0.1]}}",
    )
    made = drives(rig.scenario, rig.chain, rig.springs, 0).flexible
    assert_array_equal(made.stiffness, [1e3, 500, 2e3, 30, 1, 2, 3, 4])
    assert_array_equal(made.motor_inertia, [1, 1, 1, 1, 0.1, 0.1, 0.1, 0.1])


@parametrize(
    "row",
    [
        ("got neither", "plant.flexible_joints={}"),
        ("got both", "plant.flexible_joints={frequency: 5 Hz, stiffness: {left: [1]}}"),
        ("a frequency", "plant.flexible_joints={frequency: 5 kg}"),
        ("joints are stiff", LOOP),
        ("whole numbers", FLEXIBLE, "control.joint_torque={rate: 3 kHz}"),
        ("whole numbers", FLEXIBLE, "control.joint_torque={rate: 8 kHz}"),
        ("ideal joints", FLEXIBLE, "plant.type=rigid"),
        (">= 0", "plant.motors={bias: -1}"),
    ],
)
def test_wrong_drives_are_refused_by_the_scenario(row):
    message, *overrides = row
    with scenario_error(message):
        osc.load_scenario("two_contact_rod", overrides)


FOUR = "[1, 1, 1, 1]"


@parametrize(
    "stiffness, message",
    {
        f"left: [1, 1, 1], right: {FOUR}": "give 4 numbers",
        f"left: {FOUR}": "give 4 numbers",
        f"left: {FOUR}, right: {FOUR}, up: {FOUR}": "up",
    },
)
def test_springs_must_fit_the_motors(stiffness, message):
    rig = rig_of("two_contact_rod", f"plant.flexible_joints={{stiffness: {{{stiffness}}}}}")
    with scenario_error(message):
        rig.plant()


def test_impossible_springs_are_refused():
    with plant_error("stiffness"):
        FlexibleJoints(vector(-1.0), vector(0.0), vector(1.0))


# --- the joint torque loop ------------------------------------------------------------------------


def loop_of(*settings, tau_max=1e9):
    joint = (vector(x) for x in (1700.0, 0.45, tau_max))
    return JointTorqueLoop(*joint, JointTorqueSpec("4 kHz", *settings))


def simulated(loop, steps, bias=0.0):
    """One flexible joint with its link held, integrated finely: τ after each period."""
    K = loop.stiffness[0]
    J = loop.motor_inertia[0]
    dt = loop.dt / 50
    theta = 0.0
    rate = 0.0
    out = []
    for _ in range(steps):
        u = loop.command(vector(1.0), vector(K * theta))[0] + bias
        for _ in range(50):
            rate += dt * (u - K * theta) / J
            theta += dt * rate
        out.append(K * theta)
    return np.array(out)


@parametrize("gain", [20.0, 60.0, 300.0])
def test_the_loop_decays_as_fast_as_its_spectral_radius(gain):
    loop = loop_of(gain)
    radius = float(loop.spectral_radius()[0])
    tau = simulated(loop, 400)
    envelope = np.maximum.accumulate(np.abs(tau[10:150] - 1.0)[::-1])[::-1] + 1e-300
    slope, _ = np.polyfit(range(140), np.log(envelope), 1)
    assert np.exp(slope) == approx(radius, abs=0.02)
    assert tau[-1] == approx(1.0, rel=1e-3)


def test_a_gain_the_sampled_loop_cannot_bear_is_refused():
    with invalid_input("unstable"):
        loop_of(6000.0)


def test_errors_of_the_motor_shrink_by_one_plus_gain():
    assert simulated(loop_of(60.0), 800, bias=6.1)[-1] - 1.0 == approx(6.1 / 61.0, rel=1e-3)


def test_motor_limits_are_kept():
    assert loop_of(tau_max=10.0).command(vector(5.0), vector(-5.0))[0] == 10.0


@parametrize("frequency", first([5, 3, 10], 1))
def test_forces_survive_flexible_joints_with_the_loop_and_not_without(frequency):
    """Force ≤ 5 % rms and at least 5 × better than without the loop."""
    flexible = f"plant.flexible_joints={{frequency: {frequency} Hz}}"
    with_loop = closed_force(verdict_of("two_contact_rod", flexible, LOOP, duration=1.5))
    assert with_loop <= 0.05
    with suppress(osc.PlantError):  # or it diverges
        without = verdict_of("two_contact_rod", flexible, duration=1.5)
        assert worst_force(without) >= 5 * with_loop


def test_the_modelled_friction_is_what_the_torque_loop_leaves_of_it():
    """Friction F of a motor is F/(1 + gain) behind the loop; passive hinges keep theirs."""
    losses = ["arms.left.friction=0.61", "arms.left.damping=1.22", "model_error.joint_friction=0.5"]
    rig = rig_of("two_contact_rod", FLEXIBLE, LOOP, *losses)
    arm, left = rig.chain.arms[0], rig.chain.slices[0]
    is_passive = np.isin(list(arm.model.names)[1:], arm.passive_joints)
    assert is_passive.sum() == 1
    modelled = rig.model.model
    friction = np.where(is_passive, 0.305, 0.305 / 61.0)
    assert_near(modelled.upperDryFrictionLimit[left], friction)
    assert_near(modelled.damping[left], 2.0 * friction)
    assert_near(rig.chain.model.upperDryFrictionLimit[left], np.full(len(friction), 0.61))
    without_loop = rig_of("two_contact_rod", FLEXIBLE, *losses).model.model
    assert_near(without_loop.upperDryFrictionLimit[left], np.full(len(friction), 0.305))


def test_an_approach_with_known_friction_behind_a_torque_loop_is_not_driven_away(own_plants):
    """The friction of a light last joint is not compensated a second time by the controller."""
    scenario = draw(67164281, 33).load().replaced(duration=1.0)
    recording = osc.run(scenario, seed=33, check=lambda rig: [])
    assert set(np.unique(recording.channels["status"])) == {int(osc.Status.OK)}
