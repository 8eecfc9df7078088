"""Sensors: their statistics, their clocks, and a plant seen through them."""

from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
from complaints import invalid_input, scenario_error
from numpy.testing import assert_allclose, assert_array_equal
from pytest import approx, mark
from rigs import largest
from samples import first
from scenario_runs import verdict_of, worst_force

import osc_contact as osc
from osc_contact.interface import Measurement, Touched
from osc_contact.plants.sensors import SensedPlant, SensorErrors, Sensors
from osc_contact.scenarios.hardware import Clock, VisionSpec

STEP = 1e-3


class Toy:
    """A plant with known readings: joint k at (k + 1) t, wrists at 5, a body that moves, turns."""

    def __init__(self):
        self.time = 0.0

    def reset(self, q):
        self.time = 0.0

    def hold(self, tau):
        pass

    def command(self, tau, duration):
        self.time += duration

    def truth(self):
        return "the truth"

    def poses(self):
        return np.tile(np.eye(4), (3, 1, 1))

    def measure(self):
        t = self.time
        X = np.eye(4)
        X[:3, :3] = pin.exp3(np.array([0.0, 0.0, 0.1 * t]))
        X[0, 3] = 0.02 * t
        V = np.array([[0.02, 0, 0, 0, 0, 0.1]])
        return Measurement(
            np.arange(1, 4) * t,
            np.arange(1.0, 4.0),
            np.full((2, 6), 5.0),
            touched=Touched(X[None], V, np.zeros((1, 6))),
            joint_torques=np.full(2, 7.0),
        )


def readings(sensors, steps, seed=0, step=STEP):
    plant = SensedPlant(Toy(), sensors, seed)
    plant.reset(np.zeros(3))
    out = [plant.measure()]
    for _ in range(steps):
        plant.command(np.zeros(2), step)
        out.append(plant.measure())
    return out


def test_an_ideal_sensor_changes_nothing_and_the_truth_is_not_touched():
    got = readings(Sensors(), 5)[-1]
    assert_array_equal(got.q, np.arange(1, 4) * Toy.measure(SimpleNamespace(time=5e-3)).q[0])
    assert_array_equal(got.v, [1, 2, 3])
    assert SensedPlant(Toy(), Sensors()).truth() == "the truth"


def test_noise_and_bias_have_the_size_given():
    clock = Clock(1e3)
    noise = np.array([0.1, 0.1, 0.1, 0.01, 0.01, 0.01])
    bias = 10 * noise
    out = readings(Sensors(wrists=(clock, SensorErrors(noise, bias))), 4000)
    read = np.array([m.wrenches for m in out])
    offset = read.mean(axis=0) - 5.0
    assert np.all(np.abs(offset) < bias + 0.1 * noise) and largest(offset / bias) > 0.2
    assert_allclose(read.std(axis=0) / noise, 1.0, atol=0.06)
    white = (read - read.mean(axis=0)).reshape(len(read), -1)
    together = np.corrcoef(white.T) - np.eye(12)
    assert largest(together) < 0.08
    assert largest((white[1:] * white[:-1]).mean(axis=0) / white.var(axis=0)) < 0.08


def test_resolution_rounds_to_whole_steps():
    out = readings(Sensors(encoders=(Clock(1e3), SensorErrors(resolution=0.01))), 100)
    q = np.array([m.q for m in out])
    assert_allclose(q / 0.01, np.round(q / 0.01), atol=1e-9)
    true = np.arange(101)[:, None] * STEP * np.arange(1, 4)
    assert largest(q - true) <= 0.005 + 1e-12


@mark.parametrize("rate, delay", [(1000, 0.0), (1000, 0.004), (60, 0.03), (333, 0.002)])
def test_rate_and_delay_are_those_of_a_sample_and_hold(rate, delay):
    """Reading at t: the value at the last multiple of the period that is `delay` or more old."""
    out = readings(Sensors(encoders=(Clock(rate, delay), SensorErrors())), 500)
    for k, m in enumerate(out):
        t = k * STEP
        samples = np.ceil(np.arange(0, int(t * rate) + 2) / rate / STEP - 1e-6) * STEP
        arrived = samples[samples + delay <= t + 1e-9]
        want = arrived[-1] if len(arrived) else 0.0
        assert m.stamps.encoders == approx(want, abs=1e-9)
        assert_allclose(m.q, want * np.arange(1, 4), atol=1e-9)


def test_lost_samples_keep_the_old_reading():
    out = readings(Sensors(encoders=(Clock(1e3, 0.0, dropout=0.2), SensorErrors())), 5000)
    stamps = np.array([m.stamps.encoders for m in out])
    assert np.mean(np.diff(stamps) == 0.0) == approx(0.2, abs=0.02)
    assert_allclose([m.q[0] for m in out], stamps, atol=1e-9)


def test_encoders_give_no_velocity_and_vision_no_twist():
    vision = VisionSpec(60, 0.03, position={"noise": 1e-3}, orientation={"noise": 5e-3})
    got = readings(Sensors(encoders=(Clock(1e3), SensorErrors()), vision=vision), 100)[-1]
    assert np.isnan(got.v).all() and np.isnan(got.touched.V_E).all()
    assert not np.isnan(got.q).any() and got.joint_torques[0] == 7.0


def test_vision_errs_in_millimetres_and_milliradians():
    vision = VisionSpec(1e3, position={"noise": 1e-3}, orientation={"noise": 5e-3})
    out = readings(Sensors(vision=vision), 3000)
    X = np.array([m.touched.X_WE[0] for m in out])
    t = np.arange(len(X)) * STEP
    away = X[:, :3, 3] - np.outer(0.02 * t, [1, 0, 0])
    back = np.outer(-0.1 * t, [0, 0, 1])
    turn = [pin.log3(R @ pin.exp3(w)) for R, w in zip(X[:, :3, :3], back, strict=True)]
    assert_allclose(away.std(axis=0), 1e-3, rtol=0.06)
    assert_allclose(np.std(turn, axis=0), 5e-3, rtol=0.06)


def test_one_seed_one_run_and_a_reset_begins_it_again():
    sensors = Sensors(encoders=(Clock(1e3, 0, 0.1), SensorErrors(1e-3, 1e-2)))
    first, again, other = (readings(sensors, 50, seed) for seed in (1, 1, 2))
    for a, b in zip(first, again, strict=True):
        assert_array_equal(a.q, b.q)
    assert largest(first[-1].q - other[-1].q) > 1e-3
    plant = SensedPlant(Toy(), sensors, 1)
    plant.command(np.zeros(2), STEP)
    plant.reset(np.zeros(3))
    assert_array_equal(plant.measure().q, first[0].q)


def test_impossible_clocks_are_refused():
    for bad in ((0.0, 0, 0), (1.0, -1, 0), (1.0, 0, 1.0)):
        with invalid_input("Clock"):
            Clock(*bad)


@mark.parametrize(
    "override, said",
    [
        ("sensors.encoder={rate: 1 kHz, angle: {noise: 1 mm}}", "an angle"),
        ("sensors.encoder={angle: {noise: 1 mrad}}", "'rate' is missing"),
        ("sensors.wrist={rate: 1 kHz, torque: {noise: 1 N}}", "a torque"),
        ("sensors.vision={rate: 60 Hz, delay: -30 ms}", ">= 0"),
        ("sensors.vision={rate: 60 Hz, dropout: 1}", "< 1"),
        ("sensors.encoders={rate: 1 kHz}", "did you mean 'encoder'"),
    ],
)
def test_wrong_sensors_are_refused_by_the_scenario(override, said):
    with scenario_error(said):
        osc.load_scenario("two_contact_rod", [override])


# --- a better sensor is never worse ---------------------------------------------------------------

CLEAN = "sensors.encoder={rate: %g Hz}"
BITS = "sensors.encoder={rate: %g Hz, angle: {resolution: %.9e rad}, length: {resolution: %.9e m}}"


def force_error(name, rate, encoder):
    """Largest of a contact force, 2 s judged, MuJoCo."""
    verdict = verdict_of(name, f"control.rate={rate} Hz", encoder, duration=3.0)
    assert set(verdict["contact_fraction"].values()) == {1.0}
    return worst_force(verdict)


@mark.parametrize("rate", first([250, 500, 1000], 1))
@mark.parametrize("name", first(["two_contact_rod", "ur5_wipe"], 1))
def test_a_better_encoder_is_never_worse(name, rate):
    errors = [
        force_error(name, rate, encoder)
        for encoder in (
            *(BITS % (rate, 2 * np.pi / 2**bits, 1.0 / 2**bits) for bits in (20, 23, 26)),
            CLEAN % rate,
        )
    ]
    assert all(better <= 1.02 * worse for worse, better in pairwise(errors)), errors
    assert errors[-1] <= 1e-3
