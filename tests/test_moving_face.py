"""Faces that move: the plants among themselves, the law against plants that know nothing of Φ_e."""

import numpy as np
from complaints import contact_error, scenario_error
from numpy.testing import assert_allclose, assert_array_equal
from pytest import mark
from rigs import largest
from samples import module_fixture

import osc_contact as osc
from osc_contact.runs.verdict import metrics
from paper import moving_face

FACES = {
    face: [change.replace("ramp: 2 s", "ramp: 0.1 s") for change in changes]
    for face, changes in moving_face.FACES.items()
}
CONVEYOR = FACES["conveyor"]
TURNING = FACES["turning conveyor"]
SPRING = FACES["cart with spring"]
HINGE = FACES["hinge with spring"]


def rig_of(*changes):
    return osc.build_rig(osc.load_scenario("moving_face", list(changes)))


def on_the_move(rig, ticks=60):
    """A rigid plant and a controller that have run for a while (faces swing, object moves)."""
    plant = rig.plant()
    controller = rig.controller()
    for k in range(ticks):
        tau = controller.tick(plant.measure(), rig.references.at(1.0 + 1e-3 * k))
        plant.command(tau, 1e-3)
    return plant, controller


@mark.parametrize("changes", FACES.values(), ids=FACES)
def test_contact_forces_are_the_commanded_ones_at_every_instant(changes):
    """The rigid plant has no Φ_e, only a cart in its equations; α = α_u and sensing are exact."""
    rig = rig_of("plant.type=rigid", "plant.step=1 ms", *changes)
    plant, controller = on_the_move(rig)
    moved = 0.0
    for k in range(20):
        tau = controller.tick(plant.measure(), rig.references.at(1.06 + 1e-3 * k))
        plant.hold(tau)
        alpha = plant.truth().alpha
        assert_allclose(alpha, controller.signals.alpha_u, rtol=1e-9)
        controller.force_integral = np.zeros(2)
        controller.tick(plant.measure(), rig.references.at(1.06 + 1e-3 * k))
        assert_allclose(controller.signals.alpha_meas, alpha, rtol=1e-9)
        plant.command(tau, 1e-3)
        moved = max(moved, largest(plant.measure().touched.V_E))
    assert moved > 1e-3
    turns = largest(plant.measure().touched.V_E[:, 3:])
    assert (turns > 1e-2) == (changes in (TURNING, HINGE))


def test_a_law_that_ignores_the_face_is_wrong():
    rig = rig_of("plant.type=rigid", "plant.step=1 ms", "model_error.environment=ignored")
    plant, controller = on_the_move(rig)
    tau = controller.tick(plant.measure(), rig.references.at(1.3))
    plant.hold(tau)
    error = np.abs(plant.truth().alpha - controller.signals.alpha_u)[0]
    assert error > 0.05


def test_a_cart_obeys_newton():
    """m s̈ = u·(f + m g) − k s − c ṡ along the recorded path, by finite differences."""
    rig = rig_of("plant.type=rigid", "plant.step=1 ms", "gains.force.rise=0 s", *SPRING)
    rail = rig.plant().faces.rails[0]
    plant, controller = on_the_move(rig, 0)
    path = []
    force = []
    for k in range(80):
        tau = controller.tick(plant.measure(), rig.references.at(1.5 + 1e-3 * k))
        plant.hold(tau)
        truth = plant.truth()
        path.append(rail.direction @ truth.X_WE[0].translation)
        force.append(truth.alpha[0] * (rail.direction @ rig.pairs[0].direction()))
        plant.command(tau, 1e-3)
    path = np.array(path)
    force = np.array(force)
    acceleration = (path[2:] - 2 * path[1:-1] + path[:-2]) / 1e-6
    speed = (path[2:] - path[:-2]) / 2e-3
    mean = 0.5 * (force[:-2] + force[1:-1])  # held from tick to tick
    weight = -9.81 * rail.inertia * rail.direction[2]
    expected = mean + weight - rail.stiffness * path[1:-1] - rail.damping * speed
    assert_allclose(rail.inertia * acceleration, expected, atol=2e-3)
    assert largest(expected) > 0.1


def test_a_conveyor_is_where_its_signals_say():
    for plant_type in ("rigid", "mujoco"):
        rig = rig_of(f"plant.type={plant_type}", *CONVEYOR)
        plant = rig.plant()
        controller = rig.controller()
        signals = rig.scenario.contacts[0].face.motion.signals
        direction = np.array(rig.scenario.contacts[0].face.motion.direction)
        for k in range(150):
            plant.command(controller.tick(plant.measure(), rig.references.at(1e-3 * k)), 1e-3)
        s, ds, dds = signals[0].at(0.15)
        touched = plant.measure().touched
        assert_allclose(touched.X_WE[0, :3, 3], direction * s, atol=1e-7)
        assert_allclose(touched.V_E[0, :3], direction * ds, atol=1e-5)
        assert_allclose(touched.A_E[0, :3], direction * dds, atol=1e-12)
        assert_array_equal(touched.X_WE[1], np.eye(4))


@module_fixture
def on_mujoco():
    return {
        row["law"]: (row, recording)
        for row, recording in moving_face.run("mujoco", 3.0, faces=["free cart"])
    }


def test_the_full_law_keeps_the_force_on_a_free_cart(on_mujoco):
    """≤ 1 % rms with Φ_e and b_e; without them it costs more than ten times as much."""
    full = on_mujoco["full law"][0]
    without = on_mujoco["without Φ_e, b_e"][0]
    assert full["left_end_rms_error_rel"] < 0.01 and full["right_end_rms_error_rel"] < 0.01
    assert full["contact_fraction"] == without["contact_fraction"] == 1.0
    assert without["left_end_rms_error_rel"] > 10 * full["left_end_rms_error_rel"]
    assert full["travel_m"] > 0.02


def test_the_figure_shows_each_face_once(on_mujoco):
    figure = moving_face.draw(list(on_mujoco.values()))
    travel, error = figure.axes
    assert travel.get_title(loc="left") == "free cart"
    assert len(travel.lines) == len(error.lines) == 2


def test_a_conveyor_must_start_at_the_contact():
    jump = "[{type: sine, amplitude: 30 mm, frequency: 1 Hz}]"
    with scenario_error(r"left_end.*0.188\d* m/s.*ramp"):
        rig_of(
            "contacts.left_end.face.motion="
            f"{{type: conveyor, direction: [1, 0, 0], signals: {jump}}}"
        ).plant()


def test_detected_contacts_keep_the_task():
    """The controller reads N off the geometry while the object slides by a third of its stroke."""
    scenario = osc.load_scenario("two_contact_rod", ["control.contacts=detected", "duration=1.6"])
    rig = osc.build_rig(scenario)
    tracked = rig.controller().contacts
    assert all(pair.name == own.name for pair, own in zip(tracked, rig.pairs, strict=True))
    verdict = metrics(osc.run(scenario))
    for force in verdict["force"].values():
        assert force["rms_error_rel"] < 0.01
    assert verdict["motion"]["rms_error_m"] < 1e-4
    assert verdict["status"]["held"] == 0
    assert set(verdict["contact_fraction"].values()) == {1.0}


def test_tracked_contacts_are_looked_up_again_after_a_while_and_agree_with_the_declared_ones():
    rig = osc.build_rig(osc.load_scenario("two_contact_rod", ["control.contacts=detected"]))
    pair = rig.pairs[0]
    tracked = rig.controlled_pairs()[0]
    X = rig.state().X_WO
    V = np.arange(1.0, 7.0)
    seen = []
    for k in range(50):
        moved = X.copy()
        moved.translation = X.translation + 2e-4 * k * np.cross(pair.normal, [0.0, 0.0, 1.0])
        ours = tracked.contact(moved, V)
        truth = pair.contact(moved, V)
        assert_allclose(ours.N, truth.N, atol=1e-9)
        assert_allclose(ours.n_gamma, truth.n_gamma, atol=1e-9)
        assert_allclose(tracked.gaps(moved), pair.gaps(moved), atol=1e-9)
        seen.append(tracked.lookups)
    assert seen[0] == 1 and 2 < seen[-1] < 10
    away = X.copy()
    away.translation = X.translation + 0.1 * pair.normal
    assert tracked.contact(away, V).r == 1  # the last one found stays in force
    fresh = rig.controlled_pairs()[0]
    with contact_error("nothing touches"):
        fresh.contact(away, V)
