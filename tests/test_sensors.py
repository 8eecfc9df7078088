"""Sensors: statistics and clocks, calibration, estimates of velocity, vision with encoders."""

import re
from dataclasses import FrozenInstanceError, replace
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
from complaints import invalid_input, model_error, scenario_error
from numpy.linalg import eigvals, norm, solve
from numpy.random import default_rng
from numpy.testing import assert_array_equal
from pytest import approx, raises
from rigs import PANDA_Q, assert_near, largest, one_panda, placed, shift, vector
from samples import aligned, first, parametrize
from scenario_runs import closed_force, rig_of, verdict_of
from test_moving_face import TURNING

import osc_contact as osc
from osc_contact.interface import Measurement, Seen, Touched, with_readings
from osc_contact.lab.plants.sensors import SensedPlant, SensorErrors, Sensors
from osc_contact.lab.scenarios.hardware import Clock, VisionSpec
from osc_contact.sensing.calibration import calibrate_wrist
from osc_contact.sensing.reading_noise import ReadingNoise
from osc_contact.sensing.velocity_estimate import VelocityEstimate
from osc_contact.sensing.vision_fusion import History, Registration, VisionFusion

DT = 1e-3


class Toy:
    """A plant with known readings: joint k at (k + 1) t, wrists at 5, a body that moves, turns."""

    def __init__(self):
        self.time = 0.0

    measured = 0  # how often
    torque = 7.0

    def reset(self, q):
        self.time = 0.0

    def hold(self, tau):
        self.torque = tau[0]

    def command(self, tau, duration):
        self.time += duration

    def truth(self):
        return "the truth"

    def poses(self):
        return np.tile(np.eye(4), (3, 1, 1))

    def measure(self):
        self.measured += 1
        t = self.time
        X = placed(0.02 * t, rpy=(0.0, 0.0, 0.1 * t)).homogeneous
        V = np.array([[0.02, 0, 0, 0, 0, 0.1]])
        return Measurement(
            np.arange(1, 4) * t,
            np.arange(1.0, 4.0),
            np.full((2, 6), 5.0),
            touched=Touched(X[None], V, np.zeros((1, 6))),
            joint_torques=np.full(2, self.torque),
        )


def readings(sensors, steps, seed=0):
    plant = SensedPlant(Toy(), sensors, seed)
    plant.reset(np.zeros(3))
    out = [plant.measure()]
    for _ in range(steps):
        plant.command(np.zeros(2), DT)
        out.append(plant.measure())
    return out


def test_an_ideal_sensor_changes_nothing_and_the_truth_is_not_touched():
    got = readings(Sensors(), 5)[-1]
    assert_near(got.q, 5e-3 * np.arange(1, 4), rtol=1e-12)
    assert_array_equal(got.v, [1, 2, 3])
    assert SensedPlant(Toy(), Sensors()).truth() == "the truth"


def test_the_plant_is_measured_once_an_instant_and_anew_at_the_next():
    toy = Toy()
    plant = SensedPlant(toy, Sensors(wrists=(Clock(500), SensorErrors())))
    plant.command(np.zeros(2), DT)
    before = toy.measured
    assert [plant.measure().q[0] for _ in range(3)] == [DT] * 3 and toy.measured == before + 1
    plant.command(np.zeros(2), DT)
    assert plant.measure().q[0] == 2 * DT and toy.measured == before + 2
    plant.hold(np.full(2, 3.0))  # time stands still
    assert plant.measure().joint_torques[0] == 3.0
    plant.reset(np.zeros(3))
    assert plant.measure().q[0] == 0.0
    toy.measured = 0
    plant.command(np.zeros(2), DT)  # no sample is due
    assert toy.measured == 0


class InParts(Toy):
    """A plant that can also be read one sensor at a time."""

    read = ()  #: names of these readings

    def measure(self):
        return super().measure()

    def reading(self, name):
        self.read += (name,)
        return getattr(Toy.measure(self), name)


def drifting(toy):
    """Measurement of a plant whose wrists drift."""
    measured = Toy.measure(toy)
    return replace(measured, wrenches=measured.wrenches + toy.time)


class Drifting(InParts):
    measure = drifting


def test_sensors_are_read_one_at_a_time_where_the_plant_s_measurement_has_these_readings():
    clock = (Clock(1000), SensorErrors())
    sensors = Sensors(encoders=clock, joint_torques=clock, wrists=clock)
    parts, other, changed = (InParts(), Drifting(), InParts())
    changed.measure = lambda: drifting(changed)
    plants = [SensedPlant(toy, sensors) for toy in (Toy(), parts, other, changed)]
    parts.read = ()
    for plant in plants:
        plant.command(np.ones(2), DT)
    assert parts.read == ("q", "joint_torques", "wrenches") and not (other.read or changed.read)
    expected, in_parts, *drifted = (plant.measure() for plant in plants)
    for name in ("q", "v", "joint_torques", "wrenches"):
        assert_array_equal(getattr(in_parts, name), getattr(expected, name))
    for measured in drifted:
        assert_array_equal(measured.wrenches, expected.wrenches + DT)
    assert plants[0].torque_reading()[0] == DT
    assert_array_equal(plants[1].torque_reading()[1], expected.joint_torques)
    without = SensedPlant(Toy(), Sensors())
    assert_array_equal(without.torque_reading()[1], without.measure().joint_torques)


def test_with_readings_copies_like_replace():
    measured = Toy().measure()
    changes = {"q": np.ones(3), "estimated": True, "stamps": osc.Stamps(1.0)}
    copy = with_readings(measured, **changes)
    assert vars(copy) == vars(replace(measured, **changes)) and vars(measured)["stamps"] is None
    with raises(FrozenInstanceError):
        copy.q = np.zeros(3)


def test_noise_and_bias_have_the_size_given():
    clock = Clock(1e3)
    noise = vector(0.1, 0.1, 0.1, 0.01, 0.01, 0.01)
    bias = 10 * noise
    steps = SensorErrors(resolution=0.01)
    vision = VisionSpec(1e3, position={"noise": 1e-3}, orientation={"noise": 5e-3})
    wrists = (clock, SensorErrors(noise, bias))
    out = readings(Sensors(encoders=(clock, steps), wrists=wrists, vision=vision), 4000)
    t = np.arange(len(out)) * DT
    read = np.array([m.wrenches for m in out])
    offset = read.mean(axis=0) - 5.0
    assert np.all(np.abs(offset) < bias + 0.1 * noise) and largest(offset / bias) > 0.2
    assert_near(read.std(axis=0) / noise, 1.0, atol=0.06)
    white = (read - read.mean(axis=0)).reshape(len(read), -1)
    assert largest(np.corrcoef(white.T) - np.eye(12)) < 0.08
    assert largest((white[1:] * white[:-1]).mean(axis=0) / white.var(axis=0)) < 0.08
    q = np.array([m.q for m in out])
    assert_near(q / 0.01, np.round(q / 0.01), atol=1e-9)
    assert largest(q - np.outer(t, [1, 2, 3])) <= 0.005 + 1e-12
    X = np.array([m.touched.X_WE[0] for m in out])
    away = X[:, :3, 3] - np.outer(0.02 * t, [1, 0, 0])
    back = np.outer(-0.1 * t, [0, 0, 1])
    turn = [pin.log3(R @ pin.exp3(w)) for R, w in aligned(X[:, :3, :3], back)]
    assert_near(away.std(axis=0), 1e-3, rtol=0.06)
    assert_near(np.std(turn, axis=0), 5e-3, rtol=0.06)


@parametrize("delay, rate", {0.0: 1000, 0.004: 1000, 0.03: 60, 0.002: 333})
def test_rate_and_delay_are_those_of_a_sample_and_hold(rate, delay):
    """Reading at t: the value at the last multiple of the period that is `delay` or more old."""
    out = readings(Sensors(encoders=(Clock(rate, delay), SensorErrors())), 500)
    for k, m in enumerate(out):
        t = k * DT
        samples = np.ceil(np.arange(int(t * rate) + 2) / rate / DT - 1e-6) * DT
        expected = samples[samples + delay <= t + 1e-9].max(initial=0.0)
        assert m.stamps.encoders == approx(expected, abs=1e-9)
        assert_near(m.q, expected * np.arange(1, 4), atol=1e-9)


def test_lost_samples_keep_the_old_reading():
    out = readings(Sensors(encoders=(Clock(1e3, 0.0, dropout=0.2), SensorErrors())), 5000)
    stamps = np.array([m.stamps.encoders for m in out])
    assert np.mean(np.diff(stamps) == 0.0) == approx(0.2, abs=0.02)
    assert_near([m.q[0] for m in out], stamps, atol=1e-9)


def test_encoders_give_no_velocity_and_vision_no_twist():
    vision = VisionSpec(60, 0.03, position={"noise": 1e-3}, orientation={"noise": 5e-3})
    got = readings(Sensors(encoders=(Clock(1e3), SensorErrors()), vision=vision), 100)[-1]
    assert np.isnan(got.v).all() and np.isnan(got.touched.V_E).all()
    assert not np.isnan(got.q).any() and got.joint_torques[0] == 7.0


def test_one_seed_one_run_and_a_reset_begins_it_again():
    sensors = Sensors(encoders=(Clock(1e3, 0, 0.1), SensorErrors(1e-3, 1e-2)))
    first, again, other = (readings(sensors, 50, seed) for seed in (1, 1, 2))
    for a, b in aligned(first, again):
        assert_array_equal(a.q, b.q)
    assert largest(first[-1].q - other[-1].q) > 1e-3
    plant = SensedPlant(Toy(), sensors, 1)
    plant.command(np.zeros(2), DT)
    plant.reset(np.zeros(3))
    assert_array_equal(plant.measure().q, first[0].q)


@parametrize(
    "override, message",
    {
        "sensors.encoder={rate: 1 kHz, angle: {noise: 1 mm}}": "an angle",
        "sensors.encoder={angle: {noise: 1 mrad}}": "'rate' is missing",
        "sensors.wrist={rate: 1 kHz, torque: {noise: 1 N}}": "a torque",
        "sensors.vision={rate: 60 Hz, delay: -30 ms}": ">= 0",
        "sensors.vision={rate: 60 Hz, dropout: 1}": "< 1",
        "sensors.encoders={rate: 1 kHz}": "did you mean 'encoder'",
    },
)
def test_wrong_sensors_are_refused_by_the_scenario(override, message):
    with scenario_error(message):
        osc.load_scenario("two_contact_rod", [override])


# --- a better sensor is never worse ---------------------------------------------------------------

BITS = "sensors.encoder={rate: %g Hz, angle: {resolution: %.9e rad}, length: {resolution: %.9e m}}"


@parametrize("rate", first([250, 500, 1000], 1))
@parametrize("name", first(["two_contact_rod", "ur5_wipe"], 1))
def test_a_better_encoder_is_never_worse(name, rate):
    """Contact forces are compared over 2 s in MuJoCo."""
    encoders = [BITS % (rate, 2 * np.pi / 2**bits, 1.0 / 2**bits) for bits in (20, 23, 26)]
    errors = []
    for encoder in (*encoders, f"sensors.encoder={{rate: {rate} Hz}}"):
        verdict = verdict_of(name, f"control.rate={rate} Hz", encoder, duration=3.0)
        errors.append(closed_force(verdict))
    assert all(better <= 1.02 * worse for worse, better in pairwise(errors)), errors
    assert errors[-1] <= 1e-3


# Wrist calibration: exact without noise, within its promise under noise, refused when blind.


def at_rest(R, mass, com, bias):
    """Wrench that holds a body at rest: minus its weight, through its centre of mass."""
    weight = mass * R.T @ [0.0, 0.0, -9.81]
    return np.concatenate((-weight, np.cross(com, -weight))) + bias


def tilted(rng, k):
    return [pin.exp3(0.6 * rng.standard_normal(3)) for _ in range(k)]


def test_readings_of_an_arm_give_what_its_wrist_carries():
    """Hand and rod of a Panda at rest in several postures; the rod is held off the sensor."""
    chain = one_panda()
    rng = default_rng(3)
    bias = rng.standard_normal(6)
    poses = []
    readings = []
    for _ in range(5):
        state = chain.state(PANDA_Q + 0.4 * rng.standard_normal(7))
        X = state.sensors[0].inverse() * shift(state.X_WO.translation)
        poses.append(state.sensors[0].rotation)
        readings.append(X.act(pin.Force(state.bias_out)).vector + bias)
    load = calibrate_wrist(poses, readings)
    ((hand,),) = chain.outboard
    sensor = chain.model.frames[chain.model.getFrameId("arm/panda_hand")].placement
    carried = sensor.inverse().act(hand.inertia)
    carried += (state.sensors[0].inverse() * state.X_WO).act(chain.payload.inertia)
    assert load.mass == approx(carried.mass)
    assert_near(load.com, carried.lever, atol=1e-9)
    assert_near(load.bias, bias, atol=1e-9)


def test_the_standard_errors_are_the_spread_of_many_calibrations():
    rng = default_rng(1)
    R = tilted(rng, 6)
    noise = np.repeat([0.05, 0.003], 3)
    clean = np.array([at_rest(X, 1.2, [0.02, -0.01, 0.05], np.zeros(6)) for X in R])
    loads = [
        calibrate_wrist(R, clean + noise * rng.standard_normal(clean.shape), noise)
        for _ in range(2000)
    ]
    assert loads[0].mass_error == approx(np.std([load.mass for load in loads]), rel=0.1)
    assert_near(loads[0].com_error, np.std([load.com for load in loads], axis=0), rtol=0.25)


def test_a_wrist_that_only_turns_about_the_vertical_is_refused():
    """Every SCARA: weight and bias cannot be separated."""
    R = [placed(rpy=(0, 0, a)).rotation for a in np.linspace(0, 3, 8)]
    readings = [at_rest(X, 1.0, [0.01, 0.0, 0.05], np.zeros(6)) for X in R]
    with model_error(r"m, .*b_f_z.*tared"):
        calibrate_wrist(R, readings)


def at_two(alpha, beta, dt=DT):
    return VelocityEstimate(vector(alpha), vector(beta), dt)


def calibrated(k, noise):
    return calibrate_wrist(tilted(default_rng(2), k), np.zeros((k, 6)), noise)


@parametrize(
    "make, given, words",
    [
        *((Clock, bad, "Clock") for bad in ((0.0, 0, 0), (1.0, -1, 0), (1.0, 0, 1.0))),
        (calibrated, (2, 1.0), "2 postures"),
        (calibrated, (4, 0.0), "noise = 0.0"),
        (calibrated, (4, np.nan), "noise = nan"),
        *((at_two, bad, "stable") for bad in ((0.5, 3.5), (-0.1, 0.1), (0.5, 0.1, 0.0))),
        (VelocityEstimate.optimal, (0.0, 1.0, DT), "resolution"),
        (Registration, (0.0, 1e-3), "registration"),
        (Registration, (1e-3, 1e-3, (1.0, 0.0)), "registration"),
        (Registration, (1e-3, 1e-3, (1.0, 1.0), (-1.0, 0.0)), "registration"),
    ],
)
def test_bad_input_is_refused(make, given, words):
    with invalid_input(words):
        make(*given)


# The velocity estimate against the Riccati equation and against what it has to see.


def white(acceleration, dt):
    """(2, 2) what white acceleration of power acceleration² dt does to [x, v] in one period."""
    power = acceleration**2 * dt
    return power * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])


def riccati(noise, acceleration, dt):
    """Stationary gain (2,), by iterating the filter equations."""
    F = np.array([[1.0, dt], [0.0, 1.0]])
    P = np.eye(2)
    for _ in range(20_000):
        P = F @ P @ F.T + white(acceleration, dt)
        K = P[:, 0] / (P[0, 0] + noise**2)
        P = P - np.outer(K, P[0])
    return K


@parametrize("noise, acceleration", {2e-5: 2.0, 1e-4: 0.5, 1e-6: 50.0, 1e-9: 2.0})
def test_gains_are_those_of_the_riccati_equation(noise, acceleration):
    estimate = VelocityEstimate.optimal(noise, acceleration, DT)
    K = riccati(noise, acceleration, DT)
    assert_near([estimate.alpha[0], estimate.beta[0] / DT], K, rtol=1e-6)


STEP = 2.0 * np.pi / 2**16


@parametrize("period", [DT, 2 * DT])
@parametrize("acceleration", [60.0, -160.0])
def test_the_velocity_of_a_driven_joint_that_sticks_stays_small(acceleration, period):
    """Its encoder of 16 bits reads the very same; when it slips it is followed.

    Without that −160 rad/s² came to −1.3 rad/s for as long as it stuck.
    """
    estimate = VelocityEstimate.optimal(vector(STEP / np.sqrt(12.0)), 0.8, DT, period)
    every = round(period / DT)
    found = []
    for k in range(600):
        x = 0.3 if k < 400 else 0.3 + 0.5 * acceleration * (DT * (k - 400)) ** 2
        x = np.round(x / STEP) * STEP
        found.append(estimate.update(vector(x), vector(acceleration), k % every == 0)[1][0])
    assert largest(found[200:400]) < 0.06
    assert_near(found[-1], acceleration * DT * 199, rtol=0.05)


def followed(share, bits, learns):
    """Error of v (rms, rad/s) and learned share of a joint that follows `share` of 5 rad/s² rms.

    What is known swings at about 5 Hz, as commands do.
    """
    rng = default_rng(1)
    noise = 2.0 * np.pi / 2**bits * np.hypot(0.5, 12**-0.5)
    estimate = VelocityEstimate.optimal(vector(noise), 0.8, DT)
    if not learns:
        estimate = VelocityEstimate(estimate.alpha, estimate.beta, DT)
    x = v = a = 0.0
    errors = []
    for _ in range(2000):
        a += 0.03 * (40.0 * rng.normal() - a)
        x += DT * v + 0.5 * DT**2 * share * a
        v += DT * share * a
        errors.append(estimate.update(vector(x + noise * rng.normal()), vector(a))[1][0] - v)
    return np.sqrt(np.mean(np.square(errors[500:]))), estimate.share[0]


@parametrize("share", [0.0, 0.1, 0.5, 1.0, 1.4])
@parametrize("bits", [16, 18, 20])
def test_the_share_of_a_known_acceleration_that_a_joint_follows_is_learned(share, bits):
    """A rotor that the model lacks halves it, or more; friction holds the joint wholly."""
    error, learned = followed(share, bits, True)
    least, _ = followed(1.0, bits, False)
    assert abs(learned - share) < 0.1
    assert error < 2.0 * least
    if abs(share - 1.0) > 0.3:
        assert followed(share, bits, False)[0] > 2.0 * error


def test_the_estimate_with_a_learned_share_is_that_of_a_filter_that_had_it_from_the_start():
    rng = default_rng(2)
    estimate = VelocityEstimate.learning(vector(1e-4), 0.8, DT)
    plain = VelocityEstimate(estimate.alpha, estimate.beta, DT, DT, estimate.gamma)
    readings, known = rng.normal(size=(2, 300)) * [[1e-4], [30.0]]
    for x, a in zip(readings, known, strict=True):
        found = estimate.update(vector(x), vector(a))
    assert estimate.share[0] < 0.5
    for x, a in zip(readings, known, strict=True):
        expected = plain.update(vector(x), vector(estimate.share[0] * a))
    assert_near(found, expected, rtol=1e-9)
    assert_near(estimate.unknown, plain.unknown, rtol=1e-9)


@parametrize("noise", np.geomspace(1e-15, 1e-2, 14))
@parametrize("dt", [1e-3, 2e-3, 4e-3, 1 / 60])
def test_errors_of_velocity_never_alternate_for_long_however_good_the_sensor(noise, dt):
    """Eigenvalues of the error from sample to sample: at worst 0.27 from one to the next."""
    estimate = VelocityEstimate.optimal(noise, 2.0, dt)
    K = vector(estimate.alpha[0], estimate.beta[0] / dt)
    F = np.array([[1.0, dt], [0.0, 1.0]])
    poles = eigvals((np.eye(2) - np.outer(K, [1.0, 0.0])) @ F)
    assert largest(poles) < 1.0 and poles.real.min() > -0.27


def test_a_fresh_reading_corrects_what_the_acceleration_predicts():
    """The velocity by β over the period of the sensor."""
    for fresh, innovation in ((False, 0.0), (True, 99.0 - 1.002005)):
        estimate = VelocityEstimate(vector(0.5), vector(0.1), DT, 4 * DT)
        estimate.update(vector(1.0))
        estimate.v = vector(2.0)
        x, v = estimate.update(vector(99.0), vector(10.0), fresh)
        expected = (1.002005 + 0.5 * innovation, 2.01 + 25.0 * innovation)
        assert_near([x[0], v[0]], expected, rtol=1e-12)


def test_a_slow_sensor_is_followed_between_its_samples():
    """60 Hz readings of a ramp, estimates every millisecond: smooth and right."""
    estimate = VelocityEstimate.optimal(1e-3, 0.05, DT, sample=1 / 60)
    found = []
    for t in DT * np.arange(6000):
        fresh = int(t * 60) != int((t - DT) * 60)
        found.append(estimate.update(vector(0.02 * t), 0.0, fresh))
    x, v = np.array(found[4000:])[..., 0].T
    assert_near(v, 0.02, rtol=0.01)
    assert largest(np.diff(x)) < 1e-3  # no jumps at the samples


@parametrize("noise", [3e-4, 5e-3])
def test_noise_far_beyond_the_expected_one_is_measured(noise):
    """By third differences, of a joint that moves; what is expected is returned as it is."""
    rng = default_rng(3)
    sensors = ReadingNoise(vector(2e-5, 2e-5), DT)
    found = []
    for k in range(1000):
        x = 0.3 * np.sin(2.0 * np.pi * DT * k) + vector(2e-5, noise) * rng.standard_normal(2)
        found.append(sensors.update(x))
    assert (np.array(found)[:, 0] == 2e-5).all() and sensors.is_loud
    assert_near(np.mean(found[300:], axis=0)[1], noise, rtol=0.1)
    first_loud = np.argmax(np.array(found)[:, 1] > 2e-5)
    assert first_loud < 200.0 * 2e-4 / noise


def test_speeds_that_were_read_do_not_depend_on_noisy_encoders():
    given = (np.zeros(3), np.zeros(3), np.zeros((2, 6)))
    with invalid_input("noisy = True needs estimated = True.*leave noisy out"):
        Measurement(*given, noisy=True)
    assert Measurement(*given, estimated=True, noisy=True).noisy


@parametrize("expected", [2e-5, 1e-3])
@parametrize("rate", [100.0, 250.0, 500.0, 1000.0])
def test_one_wrong_reading_or_one_jump_is_no_noise_at_any_rate(rate, expected):
    """Beside the expected noise; nor are two of them 0.2 s, and 40 readings, apart."""
    noise = expected * default_rng(1).standard_normal((500, 20))
    apart = max(40, round(0.2 * rate))
    for size in (0.005, 0.02, 0.1, 3.0, 1e3):
        for change in (slice(200, 201), slice(200, None), slice(200, 201 + apart, apart)):
            sensors = ReadingNoise(np.full(20, expected), 1.0 / rate)
            readings = noise.copy()
            readings[change] += size
            for reading in readings:
                assert (sensors.update(reading) == expected).all()


@parametrize("rate", [100.0, 250.0, 500.0, 1000.0])
def test_noise_that_begins_is_announced_and_measured_by_the_last_readings(rate):
    """The mean still contains the quiet readings before it. One wrong reading is no noise."""
    first_measures = []
    for seed in range(20):
        sensors = ReadingNoise(vector(2e-5), 1.0 / rate)
        rng = default_rng(seed)
        x = np.concatenate([2e-5 * rng.standard_normal(300), 5e-3 * rng.standard_normal(100)])
        x[100] += 0.02  # one wrong reading
        x[200:] += 0.02  # one jump
        found = []
        for reading in x:
            noise = sensors.update(vector(reading))
            found.append((sensors.begins, noise[0]))
        begun = [k for k, (begins, _) in enumerate(found) if begins]
        assert len(begun) == 1 and 300 <= begun[0] < 312
        first_measures.append(found[begun[0]][1] / 5e-3)
    assert max(first_measures) < 3.0 and 0.5 < np.median(first_measures) < 1.5


@parametrize("make", [VelocityEstimate.optimal, VelocityEstimate.learning])
def test_readings_that_were_noisy_already_are_estimated_again(make):
    """Estimates are those with gains for the measured noise from the first of these readings on.

    Without it, the speeds that noise has made decay with the time constant of the new gains.
    """
    errors = 5e-3 * default_rng(2).standard_normal(8)
    found = {}
    for revises in (True, False):
        estimate, loud = make(vector(2e-5), 0.8, DT), make(vector(2e-5), 0.8, DT)
        for k in range(400):
            estimate.update(vector(0.3 * DT * k), vector(0.0))
            loud.update(vector(0.3 * DT * k), vector(0.0))
        loud.expect_noise(vector(5e-3))
        for k, error in enumerate(errors, 400):
            estimate.update(vector(0.3 * DT * k + error), vector(0.0))
            loud.update(vector(0.3 * DT * k + error), vector(0.0))
        estimate.expect_noise(vector(5e-3), revises)
        found[revises] = abs(estimate.v[0] - 0.3)
        if revises:  # the last 20 ms contain 12 quiet readings, which count less then
            assert abs(estimate.v[0] - loud.v[0]) < 0.01
    assert found[True] < 0.02 < 0.05 < found[False]


@parametrize("bits", [14, 16, 20])
@parametrize("speed", [0.0, 1e-3, 0.05, 2.0])
def test_resolution_jolts_and_missing_readings_are_no_noise(bits, speed):
    step = 2.0 * np.pi / 2**bits
    sensors = ReadingNoise(vector(step / np.sqrt(12.0)), DT)
    x, v = 0.1, speed
    for k in range(2000):
        x, v = x + DT * v, v + (1000.0 * DT if 500 <= k < 502 else 0.0)
        reading = np.nan if k % 7 == 0 else np.round(x / step) * step
        assert sensors.update(vector(reading))[0] == sensors.expected[0]
    assert not sensors.is_loud


@parametrize("make", [VelocityEstimate.optimal, VelocityEstimate.learning])
def test_an_estimate_that_expects_another_noise_is_the_one_made_for_it(make):
    """From there on; those made of gains know no noise."""
    loud = make(vector(5e-3), 0.8, DT)
    estimate = make(vector(2e-5), 0.8, DT)
    estimate.expect_noise(vector(5e-3))
    for x in default_rng(1).normal(scale=5e-3, size=(50, 1)):
        assert_near(estimate.update(x, vector(3.0)), loud.update(x, vector(3.0)), rtol=1e-12)
    with invalid_input("made from gains"):
        at_two(0.5, 0.1).expect_noise(vector(1.0))


# Vision fused with encoders: the camera's frame found, its delay undone, its noise weighed.


NOISE = (1e-3, 5e-3)


def displaced(rng, size):
    """A pose, some (m, rad) away from the identity."""
    return pin.SE3(pin.exp3(size[1] * rng.standard_normal(3)), size[0] * rng.standard_normal(3))


def scattered(rng):
    return [displaced(rng, (0.4, 1.0)) for _ in range(3)]


def noisy(X, rng):
    """Pose with the errors of the plant's camera: shifted, and turned about its origin."""
    R = pin.exp3(NOISE[1] * rng.standard_normal(3)) @ X.rotation
    return pin.SE3(R, X.translation + NOISE[0] * rng.standard_normal(3))


def lacking(estimate, true):
    """ξ = [δ; θ] with true = (exp(θ), δ) ∘ estimate."""
    rest = true * estimate.inverse()
    return np.concatenate((rest.translation, pin.log3(rest.rotation)))


@parametrize("lost", [range(3), range(10, 40)])
def test_bodies_are_located_again_after_joints_were_not_read(lost):
    """Pictures go on; joint positions that are no numbers had spoiled the camera's frame."""
    X_WC, X_WE = displaced(default_rng(2), (0.1, 0.3)), pin.SE3.Random()
    q = vector(0.3, -0.2)
    fusion = VisionFusion(
        lambda q: [pin.SE3(np.eye(3), np.array([q[0], q[1], k])) for k in range(3)],
        Registration(1e-6, 1e-6, prior=(1.0, 1.0)),
        (1.0, 1.0),
        dt=1e-3,
        period=5e-3,
        delay=0.0,
    )
    poses = [(X_WC.inverse() * X).homogeneous for X in fusion._known(q)]
    seen = Seen(poses[0], np.array(poses[1:]))
    touched = Touched((X_WC.inverse() * X_WE).homogeneous[None], *np.zeros((2, 1, 6)))
    for k in range(100):
        now = 1e-3 * k
        read = q * np.nan if k in lost else q
        found = fusion.update(now, read, 5e-3 * (k // 5), seen, touched)
    assert_near(found.X_WE[0], X_WE.homogeneous, atol=1e-3)


def test_without_noise_one_picture_finds_the_camera():
    rng = default_rng(0)
    for _ in range(20):
        X_WC = displaced(rng, (0.1, 0.3))
        known = scattered(rng)
        found = Registration(1e-9, 1e-9, prior=(1.0, 1.0))
        found.update(known, [X_WC.inverse() * X for X in known])
        assert_near(lacking(found.X, X_WC), 0.0, atol=1e-8)


def test_the_covariance_is_that_of_the_error():
    """Normalised squared error over 300 cameras: chi² with 6 degrees of freedom, mean 6 ± 0.2."""
    rng = default_rng(1)
    prior = (5e-3, 5e-3)
    squares = []
    spread = []
    for _ in range(300):
        X_WC = displaced(rng, prior)
        known = scattered(rng)
        found = Registration(*NOISE, prior=prior, drift=(0.0, 0.0))
        for _ in range(8):
            found.update(known, [noisy(X_WC.inverse() * X, rng) for X in known], 1 / 60)
        error = lacking(found.X, X_WC)
        squares.append(error @ solve(found.P, error))
        spread.append(error / np.sqrt(np.diag(found.P)))
    assert np.mean(squares) == approx(6.0, abs=4 * np.sqrt(12 / 300))
    assert_near(np.std(spread, axis=0), 1.0, atol=0.15)


def test_history_interpolates_the_past():
    history = History(0.1)
    with invalid_input("empty"):
        history.at(0.0)
    for k in range(301):
        history.add(1e-3 * k, vector(1e-3 * k, 2.0))
    assert_near(history.at(0.2345), [0.2345, 2.0], atol=1e-12)
    assert_near(history.at(9.0), [0.3, 2.0])
    assert history.at(0.0)[0] == approx(0.2, abs=2e-3)  # no further back than 0.1 s
    alone = History(1.0)
    alone.add(0.0, np.ones(1))
    assert alone.at(-1.0) == alone.at(5.0) == 1.0


VISION = (
    "sensors.vision={rate: 60 Hz, delay: 30 ms, position: {noise: 1 mm}, "
    "orientation: {noise: 5 mrad}, frame_position: 5 mm, frame_orientation: 5 mrad}"
)


@parametrize("plant", first(["mujoco", "rigid"], 1))
def test_N_follows_a_turning_face_although_camera_and_robots_disagree(plant):
    """Against the true N, with and without the fusion, while the face travels and tilts."""
    slow = [
        re.sub(": (0.7|1) Hz", ": 0.1 Hz", c).replace("ramp: 0.1 s", "ramp: 4 s") for c in TURNING
    ]
    step = {"mujoco": "0.25 ms", "rigid": "1 ms"}[plant]
    changes = (f"plant.type={plant}", f"plant.step={step}", "control.rate=1 kHz")
    rig = rig_of("moving_face", *slow, VISION, *changes)
    sensed = rig.plant(2)
    controller = rig.controller()
    observed = rig.robot(sensed, controller)
    observed.robot = SimpleNamespace(measure=lambda: read)
    pair = rig.pairs[0]
    squares = []
    for k in range(2500):
        read = sensed.measure()
        done = observed.measure()
        if k >= 1200 and k % 20 == 0:
            truth = sensed.truth()
            n = truth.X_WE[0].rotation @ pair.normal
            for touched in (done.touched, read.touched):
                X_WE = pin.SE3(touched.X_WE[0])
                off = np.cross(n, X_WE.rotation @ pair.normal)
                squares.append([off @ off, *pair.gaps(truth.X_WO, X_WE) ** 2])
        sensed.command(controller.tick(done, rig.references.at(1e-3 * k)), 1e-3)
    fused, raw = np.sqrt(np.mean(np.reshape(squares, (-1, 2, 2)), axis=0))
    assert fused[0] < 4e-3 and fused[1] < 1.2e-3, fused  # rad; m from where it touches
    assert (fused < 0.6 * raw).all(), (fused, raw)
    assert controller.status is osc.Status.OK


def test_vision_tracks_rod_and_arms_where_they_are():
    sensed = rig_of("moving_face", "plant.type=rigid", VISION).plant(5)
    seen = sensed.measure().seen
    truth = sensed.truth()
    for X, Y in aligned((seen.object, *seen.tips), sensed.plant.poses()):
        assert 1e-4 < largest(X[:3, 3] - Y[:3, 3]) < 1.5e-2
        assert norm(pin.log3(X[:3, :3] @ Y[:3, :3].T)) < 0.04
    assert_near(sensed.plant.poses()[0], truth.X_WO.homogeneous, atol=1e-12)
    assert seen.tips.shape == (2, 4, 4)


def test_a_wandering_camera_is_followed():
    rng = default_rng(2)
    known = scattered(rng)
    moved = placed(3e-3, rpy=(0, 0, 2e-3))
    found = Registration(*NOISE, drift=(1e-3, 1e-3))
    for where in (placed(), moved):
        for _ in range(600):
            found.update(known, [noisy(where.inverse() * X, rng) for X in known], 1 / 60)
    assert largest(lacking(found.X, moved)) < 1.5e-3
