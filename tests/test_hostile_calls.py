"""Calls no program should make: a tick answers all of them with torques; others with a sentence."""

from dataclasses import replace

import numpy as np
from pytest import fixture, mark, raises
from rigs import refused, rig_of

import osc_contact as osc
from osc_contact.scenarios import parse_scenario

BAD = {
    "list": lambda x: np.asarray(x).tolist(),
    "none": lambda x: None,
    "texts": lambda x: np.full(np.shape(x), "a"),
    "text": lambda x: "hello",
    "bytes": lambda x: b"ab",
    "objects": lambda x: np.full(np.shape(x), None, dtype=object),
    "large": lambda x: np.full(np.shape(x), 1e200),
    "larger": lambda x: np.full(np.shape(x), 1e308),
    "integer": lambda x: 10**400,
    "nan": lambda x: np.full(np.shape(x), np.nan),
    "complex": lambda x: np.asarray(x) + 1j,
    "row": lambda x: np.asarray(x)[None],
    "ragged": lambda x: [[1, 2], [3]],
    "group": lambda x: {},
    "generator": lambda x: (k for k in range(3)),
}


@fixture(scope="module")
def rig():
    return rig_of("two_contact_rod", "plant.type=rigid")


@fixture(scope="module")
def good(rig):
    return rig.plant().measure(), rig.references.at(0.0)


@mark.parametrize("kind", BAD)
def test_a_tick_never_raises(rig, good, kind):
    measurement, reference = good
    calls = [(None, reference), (measurement, None), ("a", 3)]
    for name in ("q", "v", "wrenches", "touched"):
        given = getattr(measurement, name)
        bad = BAD[kind](np.zeros(3) if given is None else given)
        calls.append((replace(measurement, **{name: bad}), reference))
    for name in ("V_D", "A_D", "alpha_d", "squeeze_d", "X_WD"):
        given = getattr(reference, name)
        bad = BAD[kind](given.homogeneous if name == "X_WD" else given)
        calls.append((measurement, replace(reference, **{name: bad})))
    limits = rig.chain.tau_max * (1.0 + 1e-12)
    for call in calls:
        controller = rig.controller()
        controller.tick(*good)
        tau = controller.tick(*call)
        assert np.isfinite(tau).all() and (np.abs(tau) <= limits).all()
        assert controller.status is osc.Status.OK or controller.reason
        controller.tick(*good)
        assert controller.status is osc.Status.OK


def test_the_first_tick_refuses_wrong_shapes_later_ones_hold(rig, good):
    measurement, reference = good
    for name, shape in (
        ("q", r"\(10,\), got \(9,\)"),
        ("v", r"\(10,\), got \(9,\)"),
        ("wrenches", r"\(2, 6\), got \(1, 6\)"),
    ):
        bad = replace(measurement, **{name: getattr(measurement, name)[:-1]})
        controller = rig.controller()
        with refused(f"{name}: expected shape {shape}"):
            controller.tick(bad, reference)
        controller.tick(*good)
        controller.tick(bad, reference)
        assert controller.status is osc.Status.HELD
    with refused(r"V_D: expected shape \(6,\), got \(1, 6\)"):
        rig.controller().tick(measurement, replace(reference, V_D=reference.V_D[None]))


@mark.parametrize("plant", ["rigid", "mujoco"])
@mark.parametrize("duration", [-1.0, 0.0, np.nan, np.inf])
def test_a_step_that_takes_no_time_is_refused(plant, duration):
    rig = rig_of("two_contact_rod", f"plant.type={plant}")
    with refused("positive, finite time"):
        rig.plant().command(np.zeros(rig.chain.n_a), duration)


def test_a_run_without_end_is_refused():
    with raises(osc.ScenarioError, match="duration"):
        osc.load_scenario("two_contact_rod", ["duration=1e12"])


def test_a_scenario_of_a_hundred_megabytes_is_refused_at_once(tmp_path):
    path = tmp_path / "large.yaml"
    with open(path, "wb") as file:
        file.truncate(100_000_000)
    with raises(osc.ScenarioError, match=r"has 100\.0 MB; scenarios are read up to 1 MB"):
        osc.load_scenario(path)
    with raises(osc.ScenarioError, match="characters"):
        parse_scenario("a: 1\n" * 1_000_000)
