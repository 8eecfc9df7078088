"""All errors of a real workcell at once, the keys of `model_error` that make them."""

import numpy as np
from complaints import scenario_error
from numpy.testing import assert_allclose
from pytest import approx, mark
from scenario_runs import rig_of, verdict_of, worst_force

import osc_contact as osc
from benchmarks.combined_errors import MASSES, judge


@mark.parametrize("mass", MASSES)
@mark.parametrize("name, side", [("two_contact_rod", 90), ("panda_edge", 0)])
def test_all_errors_at_once(name, mass, side):
    verdict = judge(name, mass, side)
    assert set(verdict["contact_fraction"].values()) == {1.0}
    assert worst_force(verdict) < 0.03


def test_a_hidden_mass_is_in_the_plant_and_not_in_the_model():
    """It weighs m g where the left arm grasps the rod; MuJoCo's own masses tell the same."""
    rig = rig_of("two_contact_rod", "model_error.hidden_mass=0.3 kg")
    rigs = rig, rig_of()
    X = rig.state().X_WO
    gravity = np.array([0.0, 0.0, -9.81])
    true, believed = (
        chain.payload.terms(X, np.zeros(6), gravity).p for chain in (rig.chain, rig.model)
    )
    tip = np.array([-0.15, 0.0, 0.0])  # of the left arm, in the frame of the rod
    want = np.cross(X.rotation @ tip, -0.3 * gravity)
    assert_allclose(true - believed, [*(-0.3 * gravity), *want], atol=1e-9)
    with_mass, without = (rig.plant().model for rig in rigs)
    assert with_mass.body_subtreemass[0] - without.body_subtreemass[0] == approx(0.3, abs=1e-9)
    rod, bare = (model.body("object/root") for model in (with_mass, without))
    assert_allclose(rod.ipos, (0.3 * tip + bare.mass * bare.ipos) / rod.mass, atol=1e-9)


@mark.parametrize("name", ["two_contact_rod", "panda_edge", "ur5_wipe", "three_arm_plate"])
def test_bodies_are_believed_to_be_nearer(name):
    rig = rig_of(name, "model_error.face_offset=3 mm")
    for body in rig.bodies:
        gaps = rig.controlled_pairs()[body.contacts[0]].gaps(rig.state().X_WO)
        assert_allclose(gaps, -0.003, atol=1e-8)


def test_faces_are_believed_to_be_turned_about_where_they_touch():
    turned = []
    for about in (0, 90):
        wrong = ["model_error.face_tilt=3 deg", f"model_error.face_tilt_about={about} deg"]
        rig = rig_of("two_contact_rod", *wrong)
        X = rig.state().X_WO
        for pair, believed in zip(rig.pairs, rig.controlled_pairs(), strict=True):
            assert believed.gap(X) == approx(0.010 * (np.cos(np.deg2rad(3)) - 1), abs=1e-8)
            turned.append(np.cross(pair.normal, believed.normal))
    assert_allclose([t @ t for t in turned], np.sin(np.deg2rad(3)) ** 2, atol=1e-9)
    assert abs(turned[0][2]) < 1e-9 > abs(turned[0] @ turned[2])


def test_a_pair_of_ones_own_cannot_be_displaced():
    scenario = osc.load_scenario("two_contact_rod", ["model_error.face_offset=3 mm"])
    own = [{"pair": osc.build_rig(scenario).pairs[0], "body": "wall"}, scenario.contacts[1]]
    wall = {"name": "wall", "urdf": "face.urdf"}
    rig = osc.build_rig(scenario.replaced(contacts=own, environment=[wall]))
    with scenario_error("put another pair into the controller"):
        rig.controller()


def test_friction_that_turns_back_is_commanded_in_time():
    """Of two Pandas that slide to and fro, with friction that they learn."""
    verdict = verdict_of("dual_panda_rod", "plant.friction=0.2", "duration=4 s")
    assert worst_force(verdict) < 0.015


@mark.parametrize("time", [0.004, 0.02])
def test_points_that_slide_on_hard_faces_keep_contact(time):
    changes = ["plant.friction=0.2", f"plant.solref=[{time}, 1]", "duration=2 s"]
    verdict = verdict_of("two_contact_rod", *changes)
    assert set(verdict["contact_fraction"].values()) == {1.0}
