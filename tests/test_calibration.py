"""Wrist calibration: exact without noise, within its promise under noise, refused when blind."""

import numpy as np
import pinocchio as pin
from command_line import answered, refused
from complaints import model_error
from numpy.random import default_rng
from numpy.testing import assert_allclose
from pytest import approx, mark, raises

import osc_contact as osc
from osc_contact.runs.calibration import calibrate
from osc_contact.sensing.calibration import calibrate_wrist

G = np.array([0.0, 0.0, -9.81])


def at_rest(R, mass, com, bias):
    """What holds a body up, by hand: minus its weight, through its centre of mass."""
    weight = R.T @ (mass * G)
    return np.concatenate((-weight, np.cross(com, -weight))) + bias


def tilted(rng, k, angle=0.6):
    return [pin.exp3(angle * rng.normal(size=3)) for _ in range(k)]


def test_exact_readings_give_exact_loads():
    rng = default_rng(0)
    for _ in range(20):
        mass = rng.uniform(0.3, 5)
        com = rng.uniform(-0.1, 0.1, 3)
        bias = rng.normal(size=6)
        R = tilted(rng, 5)
        load = calibrate_wrist(R, np.array([at_rest(X, mass, com, bias) for X in R]))
        assert load.mass == approx(mass, rel=1e-10)
        assert_allclose(load.com, com, atol=1e-10)
        assert_allclose(load.bias, bias, atol=1e-9)


def test_the_standard_errors_are_the_spread_of_many_calibrations():
    rng = default_rng(1)
    R = tilted(rng, 6)
    noise = np.repeat([0.05, 0.003], 3)
    clean = np.array([at_rest(X, 1.2, np.array([0.02, -0.01, 0.05]), np.zeros(6)) for X in R])
    loads = [
        calibrate_wrist(R, clean + noise * rng.standard_normal(clean.shape), noise)
        for _ in range(2000)
    ]
    spread = np.std([load.mass for load in loads])
    assert loads[0].mass_error == approx(spread, rel=0.1)
    assert_allclose(loads[0].com_error, np.std([load.com for load in loads], axis=0), rtol=0.25)


def test_a_wrist_that_only_turns_about_the_vertical_is_refused():
    """Every SCARA: weight and bias cannot be told apart."""
    R = [pin.exp3(np.array([0.0, 0.0, a])) for a in np.linspace(0, 3, 8)]
    readings = np.array([at_rest(X, 1.0, np.array([0.01, 0.0, 0.05]), np.zeros(6)) for X in R])
    with model_error(r"m, .*b_f_z.*tared"):
        calibrate_wrist(R, readings)


@mark.parametrize("k, noise", [(2, 1.0), (4, 0.0), (4, float("nan"))])
def test_bad_input_is_refused(k, noise):
    R = tilted(default_rng(2), k)
    with raises(osc.InvalidInputError):
        calibrate_wrist(R, np.zeros((k, 6)), noise)


def test_a_panda_finds_mass_to_one_per_cent_and_centre_to_two_millimetres():
    for seed in range(2):
        (found,) = calibrate(osc.load_scenario("panda_wrist"), postures=6, average=0.1, seed=seed)
        told = found.as_dict()
        assert told["mass_error_rel"] < 0.01
        assert told["com_error_m"] < 2e-3
        assert np.abs(found.found.bias[:3]).max() > 0.2  # there was something to find


def test_the_truth_it_is_compared_with_is_what_the_urdfs_weigh():
    (found,) = calibrate(osc.load_scenario("panda_wrist", ["sensors={}"]), average=0.01)
    assert found.mass == approx(0.73 + 0.015 * 2 + 1.5, abs=0.01)  # hand, fingers, rod
    assert found.found.mass == approx(found.mass, rel=1e-9)
    assert_allclose(found.found.com, found.com, atol=1e-9)


def test_the_command_prints_and_writes_what_was_found():
    assert answered("calibrate panda_wrist --postures 4")[1]["arm"]["mass_error_rel"] < 0.01
    refused("calibrate workcell")
