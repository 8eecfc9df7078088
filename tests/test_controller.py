"""The assembled controller: its wiring, its manners when data are bad, its limits."""

import copy
import pickle
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pinocchio as pin
from grasp_oracle import kkt
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from pytest import approx, fixture, mark
from rigs import UNLIMITED, largest, refused, rig_of

import osc_contact as osc
from osc_contact.control.controller import Controller
from osc_contact.control.status import SafetyState
from osc_contact.scenarios.control_schema import MotionGains
from paper.diagrams import BLOCKS


@fixture(scope="module")
def rig():
    return rig_of("two_contact_rod")


@fixture
def ready(rig):
    """(controller, plant, measurement, reference) after one good tick."""
    controller = rig.controller()
    plant = rig.plant()
    measurement = plant.measure()
    reference = rig.references.at(0.0)
    controller.tick(measurement, reference)
    assert controller.status is osc.Status.OK
    return controller, plant, measurement, reference


@mark.parametrize("value", [np.nan, np.inf, -np.inf])
@mark.parametrize("key", ["q", "v", "wrenches"])
def test_a_bad_measurement_repeats_the_last_torques_and_freezes_the_integrators(ready, key, value):
    controller, _, measurement, reference = ready
    last = controller.tick(measurement, reference)
    before = controller.force_integral.copy(), controller.motion_integral.copy()
    for index in range(getattr(measurement, key).size):
        data = getattr(measurement, key).copy()
        data.flat[index] = value
        tau = controller.tick(replace(measurement, **{key: data}), reference)
        assert controller.status is osc.Status.HELD and controller.reason
        if index < 2:
            assert_array_equal(tau, last)
        assert np.isfinite(tau).all() and (np.abs(tau) <= controller.chain.tau_max).all()
    assert_array_equal(controller.force_integral, before[0])
    assert_array_equal(controller.motion_integral, before[1])
    controller.tick(measurement, reference)
    assert controller.status is osc.Status.OK


@mark.parametrize(
    "change",
    [
        {"q": np.zeros(9)},
        {"v": np.zeros((10, 1))},
        {"wrenches": np.zeros((1, 6))},
        {"wrenches": np.zeros(12)},
        {"alpha_d": np.array([10.0, np.nan])},
        {"alpha_d": np.array([10.0])},
        {"V_D": np.full(6, np.inf)},
        {"V_D": np.zeros(3)},
        {"A_D": np.zeros((6, 1))},
        {"squeeze_d": float("nan")},
    ],
)
def test_what_does_not_fit_repeats_the_last_torques(ready, change):
    controller, _, *given = ready
    last = controller.tick(*given)
    changed = [replace(one, **change) if hasattr(one, next(iter(change))) else one for one in given]
    assert_array_equal(controller.tick(*changed), last)
    assert controller.status is osc.Status.HELD and controller.reason


def test_torques_never_exceed_a_motor_limit(ready):
    controller, _, measurement, reference = ready
    controller = controller.with_safety(UNLIMITED)
    limits = controller.chain.tau_max
    wanted = replace(reference, alpha_d=np.array([3000.0, 10.0]))
    for _ in range(round(controller.gains.force.rise / controller.dt)):  # the step is let in
        tau = controller.tick(measurement, wanted)
        assert (np.abs(tau) <= limits).all()
    assert controller.status is osc.Status.SATURATED
    assert largest(tau / limits) == approx(1.0)
    assert "joint" in controller.reason


def test_stretched_elbows_degrade_and_a_wall_that_the_arms_cannot_push_is_held(rig, ready):
    controller, _, measurement, reference = ready
    controller = controller.with_safety(UNLIMITED)  # another posture at once
    straight = measurement.q.copy()
    straight[[1, 6]] = 0.0  # both elbows stretched
    tau = controller.tick(replace(measurement, q=straight), reference)
    assert controller.status is osc.Status.DEGRADED
    assert "near a singular posture" in controller.reason
    assert np.isfinite(tau).all() and (np.abs(tau) <= controller.chain.tau_max).all()

    # a couple about the heading of the rod: both grippers' structure carries it
    class Twist:
        name = "twist"

        def contact(self, X_WO, V_O, X_WE=None, V_E=None):
            heading = X_WO.rotation[:, 0].copy()
            heading[2] = 0.0
            return osc.Contact(np.concatenate((np.zeros(3), heading))[:, None])

        def gaps(self, X_WO, X_WE=None):
            return np.zeros(1)

    blocked = Controller(rig.model, [Twist()])
    first = blocked.tick(measurement, replace(reference, alpha_d=np.ones(1)))
    assert blocked.status is osc.Status.HELD and "cannot push on contact column 0" in blocked.reason
    assert blocked.state is SafetyState.HOLD and first.any()  # there is nothing to repeat yet


def test_wiring_is_complete_and_runs_forward(rig):
    """Every signal of fig. 4 is read or is a torque, every input exists before it is read."""
    known = {"q", "v", "wrenches", "touched", "reference", "alpha_d", "squeeze_d"}
    for block in BLOCKS:
        assert block.inputs and block.outputs, block.name
        assert set(block.inputs) <= known, block.name
        known |= set(block.outputs)
    read = {name for block in BLOCKS for name in block.inputs}
    assert known - read == {"tau"}
    controller = rig.controller()
    controller.tick(rig.plant().measure(), rig.references.at(0.0))
    assert all(hasattr(controller.signals, name) for name in known)


def test_figure_5_is_the_force_path_of_the_paper():
    path = [b for b in BLOCKS if b.group == "force"]
    assert [b.outputs for b in path] == [
        ("f_meas",),
        ("f_c_meas",),
        ("alpha_meas",),
        ("alpha_u",),
        ("f_ccomm",),
    ]
    assert {"alpha_d", "alpha_meas"} <= set(path[3].inputs)


def test_engaging_keeps_what_was_learnt_in_free_space(rig):
    """The motion integral becomes a constant wrench: without forces the torques do not jump."""
    gains = osc.Gains(osc.MotionGains(900, 60, 9000), osc.ForceGains(30, 0))
    controller = Controller(rig.model, rig.pairs, gains, engaged=False)
    plant = rig.plant()
    measurement = plant.measure()
    reference = rig.references.at(0.0)
    controller.tick(measurement, reference)
    controller.motion_integral = np.array([1e-3, -2e-3, 3e-3, 0.0, 1e-3, 2e-3])
    controller.tick(measurement, reference)
    s = controller.signals
    force = s.f_S.copy()
    learnt = s.state.Lambda_S @ s.eta_c
    controller.engage()
    assert controller.engaged and not controller.motion_integral.any()
    assert_allclose(s.state.S.T @ controller.f_bias, learnt, rtol=1e-6, atol=1e-9)
    controller.engaged = False  # the same free motion, now with the bias in place of the integral
    controller.tick(measurement, reference)
    assert_allclose(controller.signals.f_S, force, rtol=1e-3, atol=1e-3)


def test_without_contacts_the_whole_motion_is_controlled(rig):
    """Of all accelerations that the arms permit the object gets the one nearest to the command."""
    controller = Controller(rig.model, (), joint_friction=False)
    reference = replace(rig.references.at(0.0), alpha_d=np.zeros(0), A_D=np.arange(1.0, 7.0))
    measurement = rig.plant().measure()
    tau = controller.tick(measurement, reference)
    assert controller.status is osc.Status.OK, controller.reason
    miss = kkt(rig.chain, measurement.q, measurement.v, tau).a_object - controller.signals.a_u
    state = controller.signals.state
    assert_allclose(state.S.T @ state.metric @ miss, 0.0, atol=1e-8)


@mark.parametrize(
    "make, words",
    [
        (lambda rig: Controller(rig.model, rig.pairs, dt=0.0), "dt"),
        (lambda rig: Controller(rig.model, rig.pairs, dt=np.nan), "dt"),
        (lambda rig: Controller(rig.model, rig.pairs, B="euclid"), "object"),
        (lambda rig: rig.controller().residual_wrench(), "no tick"),
        (lambda rig: MotionGains(100, 10, 2000), "Routh"),
    ],
)
def test_bad_settings_are_refused(rig, make, words):
    with refused(words):
        make(rig)


def test_arms_without_wrist_sensors_cannot_control_contact_forces():
    """Half the sensors would weigh half the object and still look plausible."""
    scenario = osc.load_scenario("two_contact_rod", ["arms.left.wrist_sensor=null"])
    rig = osc.build_rig(scenario)
    with refused("left"):
        rig.controller()


# --- settings are taken once, controllers share nothing ------------------------------------------


@mark.parametrize(
    "name",
    ["gains", "dt", "B", "contacts", "friction", "bodies", "posture", "life", "signals", "x"],
)
def test_what_would_be_ignored_is_refused(ready, name):
    with refused("with_gains"):
        setattr(ready[0], name, None)


def test_other_gains_go_on_without_a_jump(rig):
    gains = osc.Gains(osc.MotionGains(900, 60, 9000), osc.ForceGains(30, 0))
    bare = UNLIMITED  # the very same readings again and again
    controller = Controller(rig.model, rig.pairs, gains, safety=bare)
    plant = rig.plant()
    measurement = plant.measure()
    reference = rig.references.at(0.0)
    shift = np.array([1e-3, -2e-3, 1e-3, 2e-3, 1e-3, -1e-3])
    away = replace(reference, X_WD=reference.X_WD * pin.exp6(pin.Motion(shift)))
    for _ in range(50):
        controller.tick(measurement, away)
    X_WO = pin.SE3(controller.result().X_WO.copy())
    still = replace(reference, X_WD=X_WO, V_D=np.zeros(6), A_D=np.zeros(6))
    assert largest(controller.motion_integral) > 1e-5
    alike = copy.copy(controller)
    tau = alike.tick(measurement, still)
    for integral in (3000.0, 0.0):
        changed = osc.Gains(osc.MotionGains(400, 40, integral), gains.force)
        other = controller.with_gains(changed)
        assert other.gains is changed and controller.gains is gains
        got = other.tick(measurement, still)
        assert other.status is osc.Status.OK, other.reason
        # handed to f_bias the force on the object stays, though no acceleration is expected of it
        assert_allclose(other.signals.f_S, alike.signals.f_S, rtol=1e-6, atol=1e-6)
        if integral:
            assert_allclose(got, tau, rtol=0, atol=1e-9 * largest(tau))
    assert_array_equal(controller.gains.force.integral, 30)


def test_copies_and_pickles_go_on_alike_and_alone(ready):
    controller, _, measurement, reference = ready
    controller.f_tare = np.arange(6.0)
    controller.tick(measurement, reference)
    others = [copy.copy(controller), copy.deepcopy(controller)]
    others.append(pickle.loads(pickle.dumps(controller)))
    for other in others:
        assert other.status is controller.status
        assert_array_equal(other.signals.tau, controller.signals.tau)
    moved = replace(measurement, q=measurement.q + 1e-4)
    tau = controller.tick(moved, reference)
    before = [other.motion_integral for other in others]
    assert all((x != controller.motion_integral).any() for x in before)
    for other in others:
        assert_array_equal(other.tick(moved, reference), tau)
    held = copy.deepcopy(controller.signals)
    controller.tick(measurement, reference)
    assert_array_equal(held.tau, tau)  # what signals say is not changed by later ticks
    assert_array_equal(held.q, moved.q)
    assert held.state.d == 5


def test_two_threads_on_one_chain_do_not_disturb_one_another(rig):
    reference = rig.references.at(0.0)
    m = rig.plant().measure()
    rng = default_rng(4)
    stories = [
        [replace(m, q=m.q + 1e-3 * rng.standard_normal(10)) for _ in range(300)] for _ in "ab"
    ]

    def run(story):
        controller = rig.controller()
        return [
            np.append(controller.tick(x, reference), controller.signals.state.Lambda_S)
            for x in story
        ]

    with ThreadPoolExecutor(2) as pool:
        assert_array_equal(list(pool.map(run, stories)), [run(story) for story in stories])
