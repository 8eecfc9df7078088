"""The two plants: laws of physics they must keep, and agreement with each other."""

import logging
from pathlib import Path

import numpy as np
import pinocchio as pin
from complaints import invalid_input, model_error, plant_error, scenario_error
from numpy.testing import assert_array_equal
from rigs import largest, rigid_plant
from samples import module_fixture, parametrize
from scenario_runs import rig_of

import osc_contact as osc
from osc_contact.lab.plants.rigid import RigidPlant
from osc_contact.lab.rig.rig import PLANTS


@module_fixture
def rig():
    return rig_of()


def energy(plant):
    return pin.computeMechanicalEnergy(plant.model, plant.model.createData(), plant.q, plant.v)


def test_rigid_plant_keeps_energy_and_constraints_while_it_slides_freely(rig):
    """Frictionless bilateral contacts do no work: energy is kept (second order in the step)."""
    drift = []
    for step in (2e-3, 1e-3):
        plant = rigid_plant(rig.q_contact, rig.chain, rig.pairs, step)
        start = energy(plant)
        for _ in range(round(0.2 / step)):
            plant.command(np.zeros(8), step)
        truth = plant.truth()
        drift.append(abs(energy(plant) - start))
        N = np.hstack([p.contact(truth.X_WO, truth.V_O).N for p in rig.pairs])
        assert largest(N.T @ truth.V_O) < 1e-13
        assert max(abs(p.gaps(truth.X_WO)[0]) for p in rig.pairs) < 1e-12
        assert largest(truth.V_O) > 0.1  # it does move
    assert drift[0] < 0.05
    assert drift[1] < 0.6 * drift[0]


def test_mujoco_contacts_push_and_never_pull(rig):
    plant = rig.plant()
    for _ in range(100):
        plant.command([0, 0, -120.0, 0, 0, 0, -120.0, 0], 1e-3)  # lift off
        truth = plant.truth()
        assert truth.alpha.min() >= 0.0
    assert not truth.closed.any()
    assert_array_equal(truth.alpha, 0.0)


def test_divergence_is_an_error_and_leaves_no_log_file(rig, tmp_path, monkeypatch, caplog):
    monkeypatch.chdir(tmp_path)
    plant = rig.plant()
    plant.data.qvel[:] = np.inf
    with caplog.at_level(logging.DEBUG), plant_error("diverged"):
        plant.command(np.zeros(8), 1e-3)
    assert list(Path(tmp_path).iterdir()) == []
    with invalid_input("tau: element"):
        plant.command(np.full(8, np.inf), 1e-3)
    with invalid_input("shape"):
        plant.hold(np.zeros(7))


def test_rigid_plant_refuses_to_run_away(rig):
    plant = rigid_plant(rig.q_contact, rig.chain, rig.pairs)
    plant._project_state(plant.q, plant._X, np.full(10, 2e3), np.zeros(6))
    with plant_error("diverged"):
        plant.command(np.zeros(8), 1e-3)


class Counted:
    """A contact pair whose evaluations are counted, by the object's twist."""

    def __init__(self, pair):
        self.pair = pair
        self.name = pair.name
        self.gaps = pair.gaps
        self.twists = []

    def contact(self, X_WO, V_O, *body):
        self.twists.append(V_O)
        return self.pair.contact(X_WO, V_O, *body)


def test_rigid_plant_evaluates_its_contacts_once_an_instant(rig):
    """Measured, judged and moved on; besides that, once where the step ends and once a correction.

    The step that is near enough is not corrected, and needs no columns.
    """
    pairs = [Counted(pair) for pair in rig.pairs]
    plant = rigid_plant(rig.q_contact, rig.chain, pairs)
    plant.command(np.zeros(8), 1e-3)
    for k in range(5):
        for pair in pairs:
            pair.twists.clear()
        plant.measure()
        plant.truth()
        plant.command(np.full(8, 0.1 * k), 1e-3)
        for pair in pairs:
            assert [V.any() for V in pair.twists].count(True) == 1
            assert len(pair.twists) <= 3


@parametrize(
    "scenario, name, factor",
    [
        ("two_contact_rod", "q", 1.001),
        ("two_contact_rod", "v", 1.5),
        ("two_contact_rod", "_tau", 2.0),
        ("hinge_ball_rod", "_V", 1.5),  # no arm leads the object
    ],
)
def test_equations_of_the_rigid_plant_are_those_of_its_state(scenario, name, factor):
    rig = rig_of(scenario)
    tau = np.arange(float(rig.chain.n_a))
    plant, other = (rigid_plant(rig.q_contact, rig.chain, rig.pairs) for _ in range(2))
    for one in (plant, other):
        for _ in range(20):
            one.command(tau, 1e-3)
    before = plant.measure()
    for one in (plant, other):
        setattr(one, name, factor * getattr(one, name))
    now = plant.measure()
    assert_array_equal(now.wrenches, other.measure().wrenches)
    assert largest(now.wrenches - before.wrenches) > 1e-6
    for x, y in zip(plant.accelerations(tau), other.accelerations(tau), strict=True):
        assert_array_equal(x, y)


def test_wrists_of_the_rigid_plant_read_where_it_is_and_not_where_it_was_looked_at(rig):
    plant, other = (rigid_plant(rig.q_contact, rig.chain, rig.pairs) for _ in range(2))
    plant.measure()
    q = plant.q
    plant.q = q + 0.1
    plant.poses()
    plant.q = q
    for one in (plant, other):
        one.hold(np.arange(8.0))
    assert_array_equal(plant.measure().wrenches, other.measure().wrenches)


def test_the_scene_needs_an_object(rig):
    chain = osc.ClosedChain(rig.chain.arms, rig.chain.grasps)
    with model_error("payload"):
        RigidPlant(chain, rig.pairs, 1e-3)


def test_a_registered_plant_is_named_in_scenarios(own_plants):
    """The program of docs/extend.md tests a run of it."""
    osc.register_plant("halved", exact=True)(PLANTS["rigid"])
    rig = rig_of("approach_and_slide", "plant.type=halved")
    assert rig.scenario.plant.exact
    with scenario_error("the halved plant's are bilateral"):
        rig.plant()
    with scenario_error("'mujoco', 'rigid', 'drake' or 'halved'; got 'bullet'"):
        osc.load_scenario("two_contact_rod", ["plant.type=bullet"])
