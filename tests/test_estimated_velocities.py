"""Velocities estimated from encoders, on walls that spring: docs/tuning.md#estimated-velocities."""

import re
from dataclasses import replace

import numpy as np
import pinocchio as pin
from numpy.linalg import norm, solve
from numpy.random import default_rng
from numpy.testing import assert_array_equal
from pytest import approx, mark
from rigs import rig_of, vector
from samples import first, parametrize

import osc_contact as osc
from benchmarks.random_tasks import Errors, RandomTask, draw, spring_wall
from osc_contact.contacts.pairs.pair import triad
from osc_contact.control.accelerations import expected_acceleration
from osc_contact.lab.checks.joint_rules import encoders, late_brake
from osc_contact.sensing.dead_encoders import DeadEncoders
from osc_contact.sensing.velocity_estimate import VelocityEstimate, smallest_bandwidth

pytestmark = mark.usefixtures("own_plants")  # each drawn task enters its plant

DT = 1e-3
GAINS = osc.Gains().force


def noise_of(bits):
    """Rms error (rad) of an encoder with noise of half a step."""
    return 2.0 * np.pi / 2**bits * np.hypot(0.5, 12**-0.5)


def growth(rate, late, bits, expected=True):
    """Largest growth (1/s) of a contact's modes: unit mass on an undamped spring of rate² N/m.

    Args:
        rate: √(k/m) (1/s).
        late: ticks from a force to its reading.
        bits: of the encoder.
        expected: whether the estimate knows the acceleration by measured forces.
    """
    estimate = VelocityEstimate.learning([noise_of(bits)], [0.8], DT)
    steps = 20
    h = DT / steps

    def tick(state):
        x, v, integral, drift, known, x_hat, v_hat, unknown, *forces = state
        estimate.x, estimate.v = np.array([x_hat]), np.array([v_hat])
        estimate.unknown = np.array([unknown])
        (x_hat,), (v_hat,) = estimate.update(np.array([x]), known)
        felt = forces[0]
        integral -= GAINS.integral * DT * felt
        brake = GAINS.brake * (v_hat - drift)
        drift += GAINS.drift * DT * (v_hat - drift)
        known = -brake + (integral - felt if expected else 0.0)
        for _ in range(steps):
            v += h * (integral - brake - rate**2 * x)
            x += h * v
        return [
            x,
            v,
            integral,
            drift,
            known,
            x_hat,
            v_hat,
            *estimate.unknown,
            *forces[1:],
            rate**2 * x,
        ]

    n = 8 + late
    A = np.transpose([tick(row) for row in np.eye(n)])
    return np.log(np.abs(np.linalg.eigvals(A)).max()) / DT


LATE = 3


@parametrize("bits", [14, 16, 18, 20])
def test_contacts_are_damped_up_to_a_quarter_period_of_delay_whatever_the_encoder(bits):
    quarter = 0.5 * np.pi / ((LATE + 1.5) * DT)  # torques are held for a tick
    for rate in np.linspace(60.0, 0.9 * quarter, 12):
        assert growth(rate, LATE, bits) < 0.0, rate


def test_without_measured_forces_the_same_contacts_grow():
    assert growth(100.0, LATE, 16, expected=False) > 5.0
    assert growth(100.0, LATE, 20, expected=False) < 0.0


def test_what_is_expected_is_how_the_chain_answers_measured_forces():
    """One arm: (M + JᵀΛ_oJ)⁻¹JᵀN(α_u − α)."""
    for name in ("ur5_wipe", "panda_edge"):
        rig = rig_of(name, "gains={}")
        controller = rig.controller()
        plant = rig.plant()
        for k in range(40):
            controller.tick(plant.measure(), rig.references.at(k * DT))
            plant.command(controller.last_torques(), DT)
        measured = plant.measure()
        wrenches = measured.wrenches + np.array([1.0, -2.0, 3.0, 0.1, 0.2, -0.3])
        controller.tick(replace(measured, wrenches=wrenches), rig.references.at(40 * DT))
        signals = controller.signals
        work = controller.records.work
        push = work.alpha_u[: work.rank] - signals.alpha_meas
        assert norm(push) > 0.5
        state = rig.chain.state(measured.q)
        data = rig.chain.model.createData()
        pin.crba(rig.chain.model, data, measured.q)
        M = np.triu(data.M) + np.triu(data.M, 1).T
        (tip,) = rig.chain.tips
        J = pin.computeFrameJacobian(
            rig.chain.model, data, measured.q, tip, pin.LOCAL_WORLD_ALIGNED
        )
        to_O = state.X_WO.translation - data.oMf[tip].translation
        J[:3] -= pin.skew(to_O) @ J[3:]
        Lambda_o = rig.chain.payload.terms(state.X_WO, np.zeros(6), np.zeros(3)).Lambda
        found = expected_acceleration(controller) - controller.joint_acceleration()
        answer = solve(M + J.T @ Lambda_o @ J, J.T @ signals.contact.N @ push)
        assert norm(found - answer) < 0.01 * norm(answer)  # friction of the model is in it


@parametrize("rate, sample", [(1000, 1000), (250, 1000), (1000, 250)])
def test_noise_of_an_estimate_is_what_it_is_said_to_be(rate, sample):
    rng = np.random.default_rng(0)
    estimate = VelocityEstimate.optimal(noise_of(16), 0.8, 1.0 / rate, 1.0 / sample)
    every = max(rate // sample, 1)
    readings = noise_of(16) * rng.normal(size=40_000)
    found = []
    for k, x in enumerate(readings):
        found.append(estimate.update(np.array([x]), 0.0, k % every == 0)[1][0])
    assert np.std(found[2000:]) == approx(noise_of(16) * estimate.noise_gain[0], rel=0.1)


def test_what_encoders_are_said_to_cost_is_what_they_cost_on_a_rigid_wall():
    """Faster than 5 Hz, where noise is all there is; the contact of MuJoCo passes less of it."""
    scenario = coarse(16, 0.0)
    ((said, words),) = encoders.quantity(osc.build_rig(scenario))
    recording = osc.run(scenario)
    force = recording["alpha_true"][recording["t"] > 2.0, 0]
    fast = force - np.convolve(force, np.full(200, 1.0 / 200), "same")
    assert 0.2 * said < np.std(fast[200:-200]) / words["command"] < 1.2 * said


def test_encoders_that_are_too_coarse_are_doubted_with_what_would_do():
    def doubts(resolution, *more):
        angle = f"{{angle: {{resolution: {resolution}}}, rate: 1 kHz}}"
        given = ("gains={force: {bandwidth: 5 Hz}}", "tare={}", f"sensors.encoder={angle}", *more)
        rig = rig_of("panda_edge", *given)
        return [one.text for one in osc.preflight(rig) if "encoders" in one.text]

    (text,) = doubts(0.05)
    enough = re.search(r"; ([\d.e+-]+) rad would do", text)[1]
    angular = re.search(r"joint_angular=([\d.e+-]+)", text)[1]
    assert not doubts(0.99 * float(enough) * 12**0.5)
    assert not doubts(0.05, f"control.estimate.joint_angular={0.98 * float(angular)}")


def test_rotors_that_the_model_lacks_do_not_mislead_the_velocities():
    """A Z1 whose wrist is mostly rotor stopped at 0.8 s: speeds were not those of positions."""
    task = draw(101, 2)
    task = replace(task, changes=[*task.changes, "duration=1.2 s"])
    recording = osc.run(task.load(), check=lambda rig: [])
    assert recording.meta["end_state"] == "RUN"


def test_rotors_that_the_model_lacks_do_not_make_a_contact_on_a_spring_oscillate():
    """The brake of a UR3 with rotors of ten times its wrist's links was a tenth of what K_i needs.

    It bounced off the wall with up to ten times its command, and stopped at 1.05 s.
    """
    task = draw(101, 1)
    task = replace(task, changes=[*task.changes, "duration=4 s"])
    scenario = task.load()
    recording = osc.run(scenario, seed=1, check=lambda rig: [])
    assert recording.meta["end_state"] in ("RUN", "DEGRADED")  # its posture is nearly singular
    assert set(recording["status"].tolist()) <= {osc.Status.OK, osc.Status.DEGRADED}
    landed = recording["t"] > 1.0
    assert recording["alpha_true"][landed].max() < 3.0 * recording["alpha_cmd"][landed].max()
    late = recording["t"] > 3.0
    command = recording["alpha_cmd"][late, 0]
    error = recording["alpha_true"][late, 0] - command
    assert np.sqrt(np.mean(error**2)) < 0.2 * np.mean(command)
    rotors = np.array(scenario.arms[0].armature)
    assert (np.array(recording.meta["missing_inertia"])[:3] > 0.5 * rotors[:3]).all()


# --- MuJoCo ---------------------------------------------------------------------------------------


def coarse(number, stiffness, *more):
    """10 N on a wall, a circle of 20 mm at 0.5 Hz, in the posture of a random task.

    Encoders have 16 bits, wrists are 3 ms late, and nothing else is wrong.
    """
    task = draw(7, number)
    normal = np.array(task.load().contacts[0].face.normal)
    moves = ", ".join(
        f"{{kind: linear, direction: {along.tolist()}, signals: [{{type: sine, ramp: 1 s, "
        f"amplitude: 20 mm, frequency: 0.5 Hz, phase: {phase} deg}}]}}"
        for along, phase in zip(triad(normal).T[:2], (0, 90), strict=True)
    )
    step = 2.0 * np.pi / 2**16
    sensors = (
        f"sensors={{encoder: {{rate: 1 kHz, angle: {{resolution: {step}, noise: {0.5 * step}}}}},"
        f" wrist: {{rate: 1 kHz, delay: 3 ms}}}}"
    )
    changes = [*task.changes, "control.rate=1000", sensors, "duration=4 s", "tare=null", *more]
    changes += [f"motion=[{moves}]", "force.ball=[{type: constant, value: 10 N}]"]
    task = RandomTask(7, number, task.name, task.scenario, changes, {}, Errors())
    if stiffness:
        wall = spring_wall(task.load(), stiffness)
        task = replace(task, wrong={"wall": wall}, errors=Errors(told=False))
    return task.load()


#: Draws of `benchmarks.random_tasks` with seed 7: one of each arm, then others.
NUMBERS = (16, 7, 11, 0, 34, 10, 13, 29)


@parametrize("stiffness", [3e4, 1e5, 3e5])
@parametrize("number", first(NUMBERS, 1))
def test_encoders_of_16_bits_on_springy_walls(number, stiffness):
    recording = osc.run(coarse(number, stiffness))
    judged = recording["t"] > 2.0
    command = recording["alpha_cmd"][judged, 0]
    error = recording["alpha_true"][judged, 0] - command
    assert np.sqrt(np.mean(error**2)) < 0.05 * np.mean(command)


# --- What is chosen -------------------------------------------------------------------------------


@parametrize("mode", [0.0, 60.0, 200.0, 600.0])
@parametrize("damping_ratio", [0.6, 0.7, 1.5])
def test_the_smallest_bandwidth_lets_the_brake_balance_the_integral(mode, damping_ratio):
    brake, integral = 2.0 * damping_ratio * GAINS.integral, GAINS.integral
    w = smallest_bandwidth(brake, integral, mode)
    lag = np.sqrt(2.0) * w
    s = 1j * mode
    answer = w**2 / (s**2 + (lag + brake) * s + w**2 + lag * brake)
    assert brake * answer.real == approx(integral)
    if mode == 0.0:
        assert w == approx(np.sqrt(2.0) * brake / (brake / integral - 1.0))
    assert smallest_bandwidth(integral, integral, mode) == np.inf


def chosen(bits, *changes):
    """Whether measured forces are in the estimate of `panda_edge` with encoders of so many bits."""
    step = 2.0 * np.pi / 2**bits
    angle = f"{{angle: {{resolution: {step}, noise: {0.5 * step}}}, rate: 4 kHz}}"
    return rig_of("panda_edge", f"sensors.encoder={angle}", *changes).measured_forces


def test_measured_forces_are_chosen_by_encoder_brake_and_wall_and_ones_own_setting_wins():
    default = "gains={}"
    admitted = "control.estimate.stiffest_wall=100000"
    assert chosen(16, default)
    assert not chosen(18, default)
    assert chosen(18, default, admitted)
    assert not chosen(26, default, admitted, "control.rate=4000")
    assert not chosen(16)  # gains of one mass have no brake
    assert not chosen(16, default, "control.estimate.measured_forces=false")
    assert chosen(26, default, "control.estimate.measured_forces=true")


def test_ideal_sensors_need_no_measured_forces():
    assert not rig_of("panda_edge", "gains={}").measured_forces


def test_declared_springs_are_doubted_where_measured_forces_are_switched_off():
    assert not list(late_brake.findings(osc.build_rig(coarse(NUMBERS[0], 3e4))))
    off = osc.build_rig(coarse(NUMBERS[0], 3e4, "control.estimate.measured_forces=false"))
    (finding,) = late_brake.findings(off)
    enough = float(re.search(r"damp them; ([\d.e+-]+) rad", finding.text)[1])
    assert noise_of(26) < enough < noise_of(16)


@parametrize("noise", [1e-5, 2e-5, 1e-4])
def test_a_noisy_encoder_that_repeats_itself_is_dead_and_one_at_rest_is_not(noise):
    """At rest in the middle of a step, where its readings repeat most."""
    step = 1e-5
    encoders = DeadEncoders(vector(noise, noise), vector(step, step))
    readings = np.round(default_rng(1).normal(0.0, noise, (50_000, 2)) / step) * step
    assert not any(encoders.update(q).any() for q in readings)
    stuck = readings[-1]
    ticks = 0
    while not encoders.update(np.array([readings[ticks, 0], stuck[1]]))[1]:
        ticks += 1
    assert 5 < ticks < 80 and ticks == approx(encoders.most[1], abs=1.0)
    assert_array_equal(encoders.update(stuck + step), False)


def test_repetition_is_no_evidence_without_noise_and_without_new_samples():
    ideal = DeadEncoders(np.zeros(1), np.full(1, 1e-3))
    noisy = DeadEncoders(np.full(1, 2e-5), np.full(1, 1e-5))
    for k in range(1000):
        assert not ideal.update(np.ones(1))
        assert not noisy.update(np.ones(1), fresh=k == 0)
