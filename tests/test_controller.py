"""The assembled controller: wiring, settings, limits, and whatever programs may call it with."""

import copy
import logging
import pickle
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import product

import numpy as np
import pinocchio as pin
from complaints import scenario_error
from numpy.testing import assert_array_equal
from pytest import fixture, raises
from rigs import (
    STILL,
    UNLIMITED,
    assert_near,
    held_tick,
    largest,
    one_panda,
    refused,
    rig_of,
    ticked,
    vector,
    within,
)
from samples import module_fixture, parametrize
from scenario_runs import first_inputs

import osc_contact as osc
from osc_contact.control.controller import Controller
from osc_contact.control.packing import pack_model
from osc_contact.lab.scenarios.loader import parse_scenario
from paper.diagrams import BLOCKS

GAINS = osc.Gains(osc.MotionGains(900, 60, 9000), osc.ForceGains(30, 0))


@module_fixture
def rig():
    return rig_of("two_contact_rod")


@fixture
def ready(rig):
    """(controller, measurement, reference) after one good tick."""
    controller = rig.controller()
    given = first_inputs(rig)
    ticked(controller, *given)
    return (controller, *given)


def test_places_of_views_are_where_their_numbers_stand(ready):
    """Views are tables, columns of tables and fields, in the given order."""
    records = ready[0].records
    columns = records.memory.columns
    views = [columns.alpha, records.work.X_WO, columns.covariance, records.work.f_meas[::2]]
    for number, view in enumerate(views):
        view[...] = np.arange(view.size).reshape(view.shape) + 1000.0 * number
    found = records.rows.numbers[records.places(*views)]
    assert_array_equal(found, np.concatenate([view.ravel() for view in views]))


def test_signals_of_a_tick_stay(ready):
    """Later assignments do not change them; recordings keep the permitted error (7)."""
    controller, measurement, reference = ready
    tau = ticked(controller, measurement, reference)
    signals = controller.signals
    f_meas = controller.result().f_meas.copy()
    controller.f_tare = np.ones(6)
    controller.engaged = False
    assert not controller.engaged and (controller.f_tare == 1.0).all()
    found = controller.result()
    assert_array_equal(signals.tau, tau)
    assert_array_equal(signals.q, measurement.q)
    state = signals.state
    Omega_m = signals.contact.motion_projection(np.linalg.inv(state.metric))
    for got, expected in (
        (found.f_meas, f_meas),
        (found.bias_out, state.bias_out),
        (found.V_O, state.V_O),
        (found.X_WO, state.X_WO.homogeneous),
        (found.free_error, Omega_m @ found.error),
        (found.squeeze, signals.squeeze_d),
    ):
        assert_near(got, expected, atol=1e-9)


def test_a_wall_that_the_arms_cannot_push_is_held(rig, ready):
    *_, measurement, reference = ready

    # a couple about the heading of the rod: both grippers' structure carries it
    class Twist:
        name = "twist"

        def contact(self, X_WO, V_O, X_WE=None, V_E=None):
            heading = X_WO.rotation[:, 0].copy()
            heading[2] = 0.0
            return osc.Contact(np.append(np.zeros(3), heading)[:, None])

        def gaps(self, X_WO, X_WE=None):
            return np.zeros(1)

    blocked = Controller(rig.model, [Twist()])
    desired = replace(reference, alpha_d=np.ones(1))
    first = held_tick(blocked, "cannot push on contact column 0", measurement, desired)
    assert blocked.state is osc.SafetyState.HOLD and first.any()  # there is nothing to repeat yet


def test_a_stop_by_singular_contacts_is_explained_afterwards_too():
    """A vertex 100 mm off a face of the same object, which turns: later, Python code was named."""
    rig = rig_of("panda_edge")
    X = rig.state.X_WO
    normal = X.rotation[:, 2]
    face = osc.FaceOnFace([0, 0, 0], [0, 0, -1], X.translation, normal, size=0.05, name="pad")
    tip = osc.VertexOnFace([0, 0, 0.1], point=X.translation, normal=normal, name="tip")
    controller = Controller(rig.chain, [tip, face], posture=rig.q_start)
    measured = rig.plant().measure()
    measured = replace(measured, v=np.full_like(measured.v, 0.1))
    reasons = []
    for _ in range(osc.SafetySettings().stop_after + 3):
        controller.tick(measured, osc.Reference(X, alpha_d=[5.0, 1.0, 1.0, 1.0]))
        reasons.append(controller.reason)
    assert reasons[0].startswith("pad: singular at this instant")
    assert reasons[-1].startswith("stopped, until reset() is called. Cause: contacts were singular")


def test_wiring_is_complete_and_runs_forward(rig):
    """Every signal of fig. 4 is read or is a torque, every input exists before it is read."""
    known = {"q", "v", "wrenches", "touched", "reference", "alpha_d", "squeeze_d"}
    for block in BLOCKS:
        assert block.inputs and block.outputs, block.name
        assert set(block.inputs) <= known, block.name
        known |= set(block.outputs)
    assert known - {name for block in BLOCKS for name in block.inputs} == {"tau"}
    controller = rig.controller()
    controller.tick(*first_inputs(rig))
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


def test_engaging_keeps_what_was_learnt_in_free_space(rig, ready):
    """The motion integral becomes a constant wrench: without forces the torques do not jump."""
    controller = Controller(rig.model, rig.pairs, GAINS, engaged=False)
    *_, measurement, reference = ready
    controller.tick(measurement, reference)
    controller.motion_integral = vector(1e-3, -2e-3, 3e-3, 0.0, 1e-3, 2e-3)
    controller.tick(measurement, reference)
    s = controller.signals
    force = s.f_S.copy()
    learned = s.state.Lambda_S @ s.eta_c
    controller.engage()
    assert controller.engaged and not controller.motion_integral.any()
    assert_near(s.state.S.T @ controller.f_bias, learned, atol=1e-9, rtol=1e-6)
    controller.engaged = False  # the same free motion, now with the bias in place of the integral
    controller.tick(measurement, reference)
    assert_near(controller.signals.f_S, force, atol=1e-3, rtol=1e-3)


def test_desired_forces_of_contacts_that_are_not_engaged_are_missed_aloud(caplog):
    """A scenario with a tare in a loop of one's own."""
    rig = rig_of("two_contact_rod_mismatch")
    plant = rig.plant()
    controller = rig.controller()
    reference = rig.references.at(0.0)
    assert reference.alpha_d.all()
    free = replace(reference, alpha_d=np.zeros(len(reference.alpha_d)))

    def loop(seconds, reference):
        for _ in range(round(seconds / controller.dt)):
            plant.command(controller.tick(plant.measure(), reference), controller.dt)
        assert controller.status is osc.Status.OK

    with caplog.at_level(logging.WARNING, "osc_contact.control"):
        loop(0.1, free)
        assert controller.reason == ""
        loop(2.5, reference)
    assert controller.reason.startswith("contact forces have been desired for 2.5 s, and the cont")
    assert "controller.engage()" in controller.reason
    assert "engage()" in caplog.text and len(caplog.records) == 1
    controller.engage()
    assert controller.reason == ""


def limp():
    arm = replace(one_panda().arms[0], passive_joints=("panda_joint7",))
    return osc.ClosedChain([arm], None, one_panda().payload)


@parametrize(
    "make, words",
    [
        (lambda rig: Controller(rig.model, rig.pairs, dt=0.0), "dt"),
        (lambda rig: Controller(rig.model, rig.pairs, dt=np.nan), "dt"),
        (lambda rig: Controller(rig.model, rig.pairs, B="euclid"), "object"),
        (lambda rig: rig.controller().residual_wrench(), "no tick"),
        (lambda rig: osc.MotionGains(100, 10, 2000), "Routh"),
        # half the sensors would weigh half the object and still look plausible
        (lambda rig: rig_of("two_contact_rod", "arms.left.wrist_sensor=null").controller(), "left"),
        (lambda rig: Controller(limp(), []), "posture"),
    ],
)
def test_bad_settings_are_refused(rig, make, words):
    with raises((osc.InvalidInputError, osc.ModelError), match=words):
        make(rig)


def settings_with(settings, group, **changed):
    """Settings with other values in one of their groups, a group of `gains` by its own name."""
    if group in ("motion", "force"):
        own = getattr(settings.gains, group).replaced(**changed)
        return replace(settings, gains=settings.gains.replaced(**{group: own}))
    return replace(settings, **{group: getattr(settings, group).replaced(**changed)})


def settings_without_effect(settings, group, keys):
    """Keys of a group that may change without a change of MODEL."""
    before = bytes(pack_model(settings, {}))
    own = getattr(settings.gains if group in ("motion", "force") else settings, group)
    idle = set()
    for key in keys:
        value = getattr(own, key)
        other = 40.0
        if isinstance(value, int):
            other = (not value) if isinstance(value, bool) else value + 1
        elif value is not None and 0.0 < value < np.inf:
            other = 0.9 * value
        elif value is not None:
            other = 0.1
        if bytes(pack_model(settings_with(settings, group, **{key: other}), {})) == before:
            idle.add(key)
    return idle


@parametrize(
    "group, elsewhere",
    [
        ("motion", set()),
        ("force", set()),
        ("posture_task", set()),
        ("friction", set()),
        ("life", set()),
        ("joint_friction", set()),
        ("safety", {"load_error"}),  # compared in Python, before the first contact
    ],
)
def test_every_setting_reaches_the_law(rig, group, elsewhere):
    """A key whose field in MODEL is missing, or has another name, would have no effect."""
    settings = replace(
        rig.controller().settings,
        gains=GAINS,
        friction=osc.Friction(mu=0.3),
        life=osc.PhaseSettings(),
        joint_friction=osc.JointFriction(errors=False),
    )
    own = getattr(settings.gains if group in ("motion", "force") else settings, group)
    keys = set(type(own).model_fields) - set(getattr(own, "serving", ()))
    assert settings_without_effect(settings, group, keys) == elsewhere


# --- settings are taken once, controllers share nothing ------------------------------------------


@parametrize(
    "name",
    ["gains", "dt", "B", "contacts", "friction", "bodies", "posture", "life", "signals", "x"],
)
def test_what_would_be_ignored_is_refused(ready, name):
    with refused("with_gains"):
        setattr(ready[0], name, None)


def test_other_gains_continue_without_a_jump(rig, ready):
    # the very same readings again and again
    controller = Controller(rig.model, rig.pairs, GAINS, safety=UNLIMITED)
    *_, measurement, reference = ready
    shift = vector(1e-3, -2e-3, 1e-3, 2e-3, 1e-3, -1e-3)
    away = replace(reference, X_WD=reference.X_WD * pin.exp6(shift))
    for _ in range(50):
        controller.tick(measurement, away)
    X_WO = pin.SE3(controller.result().X_WO.copy())
    still = replace(reference, X_WD=X_WO, V_D=STILL, A_D=STILL)
    assert largest(controller.motion_integral) > 1e-5
    alike = copy.copy(controller)
    tau = alike.tick(measurement, still)
    for integral in (3000.0, 0.0):
        changed = osc.Gains(osc.MotionGains(400, 40, integral), GAINS.force)
        other = controller.with_gains(changed)
        assert other.gains is changed and controller.gains is GAINS
        got = ticked(other, measurement, still)
        # handed to f_bias the force on the object stays, though no acceleration is expected of it
        assert_near(other.signals.f_S, alike.signals.f_S, atol=1e-6, rtol=1e-6)
        if integral:
            assert_near(got, tau, atol=1e-9 * largest(tau), rtol=0)
    assert_array_equal(controller.gains.force.integral, 30)


def test_copies_and_pickles_continue_alike_and_alone(ready):
    controller, measurement, reference = ready
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


def test_two_threads_on_one_chain_do_not_disturb_one_another(rig, ready):
    *_, m, reference = ready
    rng = np.random.default_rng(4)
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


# --- calls no program should make: a tick answers all of them, others are answered in a sentence --


def all_of(value):
    return lambda x: np.full(np.shape(x), value)


BAD = {
    "list": lambda x: np.asarray(x).tolist(),
    "none": lambda x: None,
    "texts": all_of("a"),
    "text": lambda x: "hello",
    "bytes": lambda x: b"ab",
    "objects": lambda x: np.full(np.shape(x), None, dtype=object),
    "large": all_of(1e200),
    "larger": all_of(1e308),
    "integer": lambda x: 10**400,
    "nan": all_of(np.nan),
    "one nan": lambda x: np.append(np.ravel(x)[:-1], np.nan).reshape(np.shape(x)),
    "infinite": all_of(-np.inf),
    "complex": lambda x: np.asarray(x) + 1j,
    "row": lambda x: np.asarray(x)[None],
    "column": lambda x: np.asarray(x)[..., None],
    "short": lambda x: np.ravel(x)[1:],
    "ragged": lambda x: [[1, 2], [3]],
    "group": lambda x: {},
    "generator": lambda x: (k for k in range(3)),
}


#: of twelve calls: readings in lists are converted, one number may come as a row of one
HELD = {"list": 8, "none": 11, "row": 11, "column": 11}


def forged(record, **fields):
    """Copy with other fields that bypass the checks of the constructor."""
    other = copy.copy(record)
    other.__dict__.update(fields)
    return other


@parametrize("kind", BAD)
def test_a_tick_never_raises_and_what_does_not_fit_repeats_the_last_torques(rig, ready, kind):
    _, *good = ready
    measurement, reference = good
    calls = [(None, reference), (measurement, None), ("a", 3)]
    for name in ("q", "v", "wrenches", "touched"):
        given = getattr(measurement, name)
        bad = BAD[kind](np.zeros(3) if given is None else given)
        calls.append((replace(measurement, **{name: bad}), reference))
    for name in ("V_D", "A_D", "alpha_d", "squeeze_d", "X_WD"):
        given = getattr(reference, name)
        bad = BAD[kind](given.homogeneous if name == "X_WD" else given)
        calls.append((measurement, forged(reference, **{name: bad})))
    limits = rig.chain.tau_max * (1.0 + 1e-12)
    not_computed = 0
    for call, start in product(calls, (good, of_kind(KINDS["lists"], *good))):
        controller = rig.controller()
        last = ticked(controller, *start)
        before = (controller.force_integral, controller.motion_integral)
        tau = controller.tick(*call)
        assert np.isfinite(tau).all() and within(tau, limits)
        if controller.status is osc.Status.HELD:
            not_computed += 1
            assert controller.reason
            if controller.state < osc.SafetyState.HOLD:  # huge speeds stop the arms at once
                assert_array_equal(tau, last)
            assert_array_equal(controller.force_integral, before[0])
            assert_array_equal(controller.motion_integral, before[1])
        else:
            assert controller.status is osc.Status.OK or controller.reason
        ticked(controller, *good)
    assert not_computed == 2 * HELD.get(kind, len(calls))


def test_the_first_tick_refuses_wrong_shapes_later_ones_hold(rig, ready):
    *_, measurement, reference = ready
    good = (measurement, reference)
    for name, shape in {
        "q": r"\(10,\), got \(9,\)",
        "v": r"\(10,\), got \(9,\)",
        "wrenches": r"\(2, 6\), got \(1, 6\)",
    }.items():
        bad = replace(measurement, **{name: getattr(measurement, name)[:-1]})
        controller = rig.controller()
        with refused(f"{name}: expected shape {shape}"):
            controller.tick(bad, reference)
        controller.tick(*good)
        controller.tick(bad, reference)
        assert controller.status is osc.Status.HELD
    with refused(r"V_D: expected shape \(6,\), got \(1, 6\)"):
        rig.controller().tick(measurement, replace(reference, V_D=reference.V_D[None]))


@parametrize("plant", ["rigid", "mujoco"])
@parametrize("duration", [-1.0, 0.0, np.nan, np.inf])
def test_a_step_that_takes_no_time_is_refused(plant, duration):
    rig = rig_of("two_contact_rod", f"plant.type={plant}")
    with refused("positive, finite time"):
        rig.plant().command(np.zeros(rig.chain.n_a), duration)


def test_a_run_without_end_is_refused():
    with scenario_error("duration"):
        osc.load_scenario("two_contact_rod", ["duration=1e12"])


def test_a_scenario_of_a_hundred_megabytes_is_refused_at_once(tmp_path):
    path = tmp_path / "large.yaml"
    with open(path, "wb") as file:
        file.truncate(100_000_000)
    with scenario_error(r"has 100\.0 MB; scenarios are read up to 1 MB"):
        osc.load_scenario(path)
    with scenario_error("characters"):
        parse_scenario("a: 1\n" * 1_000_000)


# --- lists, single precision and strided arrays ---------------------------------------------------

KINDS = {
    "float32": lambda x: np.asarray(x, dtype=np.float32),
    "strided": lambda x: np.repeat(x, 2, axis=-1)[..., ::2],
    "fortran": np.asfortranarray,
    "lists": lambda x: np.asarray(x).tolist(),
    "read-only": lambda x: np.frombuffer(np.asarray(x).tobytes()).reshape(np.shape(x)),
}


def of_kind(make, measurement, reference):
    """Copy of a tick with arrays of another type."""
    m = {name: make(getattr(measurement, name)) for name in ("q", "v", "wrenches")}
    r = {name: make(getattr(reference, name)) for name in ("V_D", "A_D", "alpha_d")}
    return (replace(measurement, **m), replace(reference, **r))


def rounded(x):
    """In numbers that single precision holds."""
    return np.float64(np.float32(x))


@parametrize("kind", KINDS)
@parametrize("sequence", [False, True])
def test_other_arrays_give_the_same_torques_and_are_never_refused_by_the_law(
    rig, monkeypatch, kind, sequence
):
    """The refusal of arrays by the compiled law costs as much as dozens of ticks."""
    plant = rig.plant()
    refused = []
    monkeypatch.setattr(Controller, "_refuse_inputs", lambda self, *args: refused.append(args))
    usual = rig.controller()
    other = rig.controller()
    for k in range(20):
        measurement, reference = of_kind(rounded, plant.measure(), rig.references.at(k * 1e-3))
        if sequence:
            measurement = replace(measurement, sequence=k)
        expected = usual.tick(measurement, reference)
        tau = other.tick(*of_kind(KINDS[kind], measurement, reference))
        assert not refused
        assert other.status is usual.status, other.reason
        assert_array_equal(tau, expected)
        assert np.array_equal(usual.motion_integral, other.motion_integral)
        plant.command(expected, 1e-3)
    assert usual.status is osc.Status.OK


def test_arrays_of_the_usual_kind_are_not_copied(ready):
    *_, measurement, reference = ready
    m = {name: getattr(measurement, name) for name in ("q", "v", "wrenches")}
    r = {name: getattr(reference, name) for name in ("X_WD", "V_D", "A_D", "alpha_d")}
    assert all(getattr(osc.Measurement(**m), name) is x for name, x in m.items())
    assert all(getattr(osc.Reference(**r), name) is x for name, x in r.items())


def test_a_plain_number_is_the_force_of_the_only_contact():
    rig = rig_of("panda_edge")
    measurement = rig.plant().measure()
    at = rig.references.at(0.0)
    assert at.alpha_d.shape == (1,)
    expected = rig.controller().tick(measurement, at)
    number = float(at.alpha_d[0])
    assert_array_equal(ticked(rig.controller(), measurement, replace(at, alpha_d=number)), expected)
    X = at.X_WD
    made = osc.pose_reference(X.translation, X.rotation, alpha_d=number)
    assert_array_equal(made.alpha_d, at.alpha_d)
