"""The two plants: laws of physics they must keep, and agreement with each other."""

import logging
from pathlib import Path

import numpy as np
import pinocchio as pin
from complaints import invalid_input, model_error, plant_error, scenario_error
from numpy.testing import assert_array_equal
from rigs import largest, rigid_plant
from samples import module_fixture
from scenario_runs import rig_of

import osc_contact as osc
from osc_contact.plants.rigid import RigidPlant
from osc_contact.runs.rig import PLANTS


@module_fixture
def rig():
    return rig_of()


def energy(plant):
    return pin.computeMechanicalEnergy(plant.model, plant.model.createData(), plant.q, plant.v)


def test_rigid_plant_keeps_energy_and_constraints_while_it_slides_freely(rig):
    """Frictionless bilateral contacts do no work: energy is kept (second order in the step)."""
    drift = []
    for step in 2e-3, 1e-3:
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
    plant._project(plant.q, plant._X, np.full(10, 2e3), np.zeros(6))
    with plant_error("diverged"):
        plant.command(np.zeros(8), 1e-3)


def test_the_scene_needs_an_object(rig):
    chain = osc.ClosedChain(rig.chain.arms, rig.chain.grasps)
    with model_error("payload"):
        RigidPlant(chain, rig.pairs, 1e-3)


def test_a_registered_plant_is_named_in_scenarios(own_plants):
    """That it runs shows the program of docs/extend.md."""
    osc.register_plant("halved", exact=True)(PLANTS["rigid"])
    rig = rig_of("approach_and_slide", "plant.type=halved")
    assert rig.scenario.plant.exact
    with scenario_error("the halved plant's are bilateral"):
        rig.plant()
    with scenario_error("'mujoco', 'rigid' or 'halved'; got 'bullet'"):
        osc.load_scenario("two_contact_rod", ["plant.type=bullet"])
