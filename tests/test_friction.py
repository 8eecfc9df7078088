"""Friction compensation in closed loop; `test_law_kkt` judges N_μ and what saturation costs."""

import numpy as np
from pytest import approx, fixture
from rigs import STILL, assert_near, refused, scara_pair, vector
from samples import parametrize
from scenario_runs import closed_force, run_of, verdict_of

import osc_contact as osc
from benchmarks.cases import POINT
from benchmarks.reversals import register_plants, reversing
from osc_contact.lab.rig.rig import PLANTS, register_plant


def worst(mu, compensation):
    changes = (f"plant.friction={mu}", f"control.friction={compensation}")
    return closed_force(verdict_of("two_contact_rod_friction", *changes, duration=2.0))


@parametrize(
    "mu, believed, limit",
    [(0.1, 0.13, 0.02), (0.1, 0.07, 0.02), (0.3, 0.39, 0.05), (0.3, 0.21, 0.05)],
)
def test_forces_survive_friction_known_within_thirty_per_cent(mu, believed, limit):
    assert worst(mu, f"{{mu: {believed}}}") <= limit


def test_without_compensation_friction_costs_twice_as_much():
    assert worst(0.3, "null") > 2 * worst(0.3, "{mu: 0.3}")


@fixture(autouse=True)
def registered(own_plants):
    register_plants()


def reversal_error(*which, duration=3.0, **plant):
    scenario = reversing(*which)
    scenario = scenario.replaced(plant=scenario.as_dict()["plant"] | plant)
    return closed_force(verdict_of(scenario, duration=duration))


@parametrize("known", [True, False])
@parametrize("stroke", [(20, 2), (5, 4)])
def test_straight_reversals(stroke, known):
    assert reversal_error("mujoco", stroke, "across", 0.3, known) < 0.01
    assert reversal_error("mujoco", stroke, "steepest", 0.2, known) < 0.01


def test_reversals_on_rigid_faces_and_in_a_cone_that_strikes():
    """The exact plant has no part of MuJoCo; one impedance for both directions lifts the peg."""
    short = {"step": 1e-3, "duration": 1.3}  # a reversal is judged
    assert reversal_error("exact", (20, 2), "across", 0.2, True, **short) < 0.002
    assert reversal_error("elliptic", (20, 2), "across", 0.2, True) > 0.03


@parametrize("solref", [[0.01, 1], [0.004, 0.7]])
def test_friction_leaves_a_face_as_stiff_as_it_is(solref):
    """Compares the penetration of a peg at 10 N with that of frictionless contacts."""
    plants = []

    @register_plant("kept")
    def keep(rig, seed):
        plants.append(PLANTS["mujoco"](rig, seed))
        return plants[-1]

    for mu in (0.0, 0.2):
        plant = {**POINT["plant"], "type": "kept", "friction": mu, "solref": solref}
        run_of(osc.Scenario.from_dict({**POINT, "plant": plant, "motion": []}), duration=0.5)
    depth = [float(plant.data.contact.dist[0]) for plant in plants]
    assert depth[1] == approx(depth[0], rel=0.1)


def test_friction_on_contacts_without_known_points_is_refused():
    pair = osc.Revolute(np.zeros(3), vector(0.0, 0.0, 1.0), name="hinge")
    with refused(r"hinge.*points of contact"):
        osc.Controller(scara_pair(), [pair], friction=osc.Friction(0.1))


@parametrize("bad", [(-0.1, 1e-3), (0.1, 0.0), (float("nan"), 1e-3)])
def test_impossible_friction_is_refused(bad):
    with refused("mu"):
        osc.Friction(*bad)


@parametrize("mu", [0.0, 0.2, 0.3])
def test_a_first_contact_shows_its_friction(mu):
    """Friction of the wiper moves its forces from corner to corner while they rise."""
    wrist = "{rate: 1 kHz, delay: 3 ms, force: {noise: 0.5 N}, torque: {noise: 0.02 Nm}}"
    changes = [f"plant.friction={mu}", "control.friction={mu: 0}"]
    changes += ["control.force.reading=least_squares", f"sensors.wrist={wrist}"]
    recording = run_of("ur5_wipe", *changes, duration=1.2)
    assert max(step["overshoot_rel"] for step in osc.metrics(recording)["steps"]) < 0.12
    assert recording["closed"][recording["t"] > 0.02].all()


def test_tangential_forces_of_a_contact_at_rest_leave_the_contact_force_as_commanded():
    """A plant without friction, pushed along its face as one that sticks would be, is the judge."""
    still = osc.Scenario.from_dict(
        {**POINT, "motion": [], "plant": {"type": "rigid", "step": "1 ms"}}
    )
    rig = osc.build_rig(still)
    plant = rig.plant()
    measurement = plant.measure()
    reference = rig.references.at(1.0)
    (pair,) = rig.pairs
    X = rig.state.X_WO
    p = pair.points_of_contact(X)[:, 0] - X.translation
    n = pair.contact(X, STILL).N[:3, 0]
    forces = []
    read = []
    for rubs in np.array([[0.0, 0.0, 0.0], [1.5, -0.4, 0.9]]):
        f = rubs - n * (n @ rubs) / (n @ n)
        controller = rig.controller()
        controller.tick(measurement, reference)
        controller.records.memory.columns.tangential[:] = f
        tau = controller.tick(measurement, reference)
        load = plant._jacobian(plant._object_state()[0]).T @ np.append(f, np.cross(p, f))
        forces.append(plant._solve_motion(tau - load).alpha[0])
        held = plant._solve_motion(tau).alpha[0] - forces[0]
        read.append(controller.records.memory.columns.tangential[0].copy())
    assert forces[1] == approx(forces[0], abs=1e-6) and abs(held) > 0.1
    assert_near(read[1] - read[0], f * 5.0 / 6.0, atol=1e-9)  # a lag of 5 ms at 1 kHz


def slow_slide(mu, **changes):
    """Recording of a Panda that slides its bar by 5 mm to and fro at 8 mm/s at most, 10 N."""
    sine = {"type": "sine", "amplitude": 0.005, "frequency": 0.25, "ramp": 1.0}
    scenario = osc.load_scenario("panda_edge", [f"plant.friction={mu}"]).replaced(
        force={"edge": [{"type": "constant", "value": 10.0}]},
        motion=[{"kind": "linear", "direction": [0, 1, 0], "signals": [sine]}],
        gains={},
    )
    return run_of(scenario, duration=5.0, **changes)


def test_a_slow_slide_follows_its_path_with_default_gains():
    """Learned friction is applied along the commanded motion, also where the contact sticks."""
    recording = slow_slide(0.2)
    moving = recording["t"] > 1.0
    away = np.linalg.norm(recording["motion_error"][moving, :3], axis=1)
    assert np.sqrt(np.mean(away**2)) < 2e-4
    error = recording["alpha_true"][moving] - recording["alpha_cmd"][moving]
    assert np.sqrt(np.mean(error**2)) < 0.01
