"""Contacts that come and go: the active set of a tick, judged by the KKT oracle of that set."""

from dataclasses import replace

import numpy as np
from active_set_cases import KNOWN, sequence, torques, worst
from numpy.random import default_rng
from numpy.testing import assert_array_equal
from processes import python
from pytest import approx, mark, raises
from rigs import UNLIMITED, assert_near, held_tick, largest, panda_pair, posed, rig_of
from samples import first, parametrize
from test_without_python import files, library, run  # noqa: F401

import osc_contact as osc
from osc_contact.lab.runs.run import start
from osc_contact.lab.runs.tape import Tape
from osc_contact.law.jit import HAS_LIBRARY
from osc_contact.law.phases import APPROACHING, CLOSED, OPEN

# --- the oracle -----------------------------------------------------------------------------------


def judged(seed, count):
    errors, sets = worst(seed, count)
    assert max(errors.values()) < 1e-9, errors
    return len(sets)


@parametrize("seed", range(3))
def test_torques_bring_the_commanded_forces_and_motion_of_the_active_set(seed):
    """Readings, forces with their integrals by column, and motion, of twelve known contacts."""
    assert judged(seed, 25) > 2


@mark.slow
@parametrize("seed", [3, 7])
def test_a_thousand_ticks_of_active_sets(seed):
    assert judged(seed, 1000) > 100


@parametrize("count", first([60, 1000], 1))
def test_plain_python_and_batches_are_equal_to_the_bit(count, tmp_path):
    words = "import sys, numpy as np; from active_set_cases import torques; "
    words += f"np.save(sys.argv[1], torques(4, {count}))"
    file = tmp_path / "tau.npy"
    python("-c", words, file, NUMBA_DISABLE_JIT="1")
    expected = torques(4, count)
    assert_array_equal(np.load(file), expected)
    scene, ticks = sequence(4, count)
    batch = osc.BatchController([scene.controller()] * 2, threads=2)
    for one, tau in zip(ticks, expected, strict=True):
        m, r = (one.measured, one.reference)
        given = (m.q, m.v, m.wrenches, r.X_WD.homogeneous)
        more = {"V_D": r.V_D, "A_D": r.A_D, "alpha_d": r.alpha_d, "active": r.active}
        found = batch.tick(
            *(np.stack([x, x]) for x in given),
            **{name: np.stack([x, x]) for name, x in more.items()},
        )
        assert_array_equal(found, [tau, tau])


@mark.skipif(not HAS_LIBRARY, reason="no library of the law is used here")
@parametrize("count", first([80, 1000], 1))
def test_a_replay_in_c_is_equal_to_the_bit(library, count, tmp_path):  # noqa: F811
    scene, ticks = packaged(5, count)
    controller = scene.controller()
    controller.save(tmp_path / "controller.osc")
    tape = Tape(controller)
    for one in ticks:
        controller.tick(one.measured, one.reference)
    (tmp_path / "recording.osc").write_bytes(tape.content())
    printed = run(library / "replay", *files(tmp_path))
    assert printed.startswith(f"{count} of {count} ticks bit-equal") and " 0 HELD" in printed


def packaged(seed, count):
    """A sequence whose pairs a file can hold."""
    while True:
        scene, ticks = sequence(seed, count)
        if not any("compiled" in contact.name for contact in scene.contacts):
            return (scene, ticks)
        seed += 100


# --- what is active -------------------------------------------------------------------------------


def vertices(count, life=None, rise=0.0, **how):
    """Two Pandas whose object stands on a plane with so many vertices."""
    chain = panda_pair()
    q, _, X = posed(chain, default_rng(1))
    force = osc.ForceGains(rise=rise)
    rng = default_rng(2)
    spots = np.column_stack((rng.uniform(-0.2, 0.2, (count, 2)), np.full(count, -0.05)))
    up = X.rotation @ np.array([0.0, 0.0, 1.0])
    pairs = [osc.VertexOnFace(spot, X.act(spot), up) for spot in spots]
    how |= {"life": life, "posture": q, "safety": UNLIMITED}
    controller = osc.Controller(chain, pairs, osc.Gains(force=force), **how)
    measured = osc.Measurement(q, 0.0 * q, 10.0 * rng.standard_normal((2, 6)))
    return (controller, measured, X)


def test_active_with_no_desired_force_and_not_active_are_two_things():
    controller, measured, X = vertices(3, osc.PhaseSettings())
    none = np.zeros(3)
    controller.tick(measured, osc.Reference(X, alpha_d=none, active=[1, 0, 1]))
    assert controller.active.tolist() == [True, False, True]
    for _ in range(2):
        controller.tick(measured, osc.Reference(X, alpha_d=none, active=[1, 1, 0]))
    assert controller.phases()[1:].tolist() == [APPROACHING, OPEN]
    controller.tick(measured, osc.Reference(X, alpha_d=none))
    assert controller.phases().tolist() == [OPEN] * 3
    controller.tick(measured, osc.Reference(X, alpha_d=[5.0, 0.0, 5.0]))
    assert controller.active.tolist() == [True, False, True]


def test_pairs_that_hold_come_and_go_with_and_without_phases():
    chain = panda_pair()
    q, _, X = posed(chain, default_rng(1))
    hole = osc.Prismatic([0, 0, 0], [0, 0, 1], assembled=X)
    still = osc.Measurement(q, 0.0 * q, np.zeros((2, 6)))
    for life in (None, osc.PhaseSettings()):
        controller = osc.Controller(chain, [hole], life=life, reading="filter", safety=UNLIMITED)
        seen = []
        for active in (None, [0], [0], [1], None):
            controller.tick(still, osc.Reference(X, alpha_d=np.zeros(5), active=active))
            seen.append(int(controller.phases()[0]))
            assert len(controller.force_integral) == 5 * (seen[-1] != OPEN)
        assert seen == [CLOSED, OPEN, OPEN, CLOSED, CLOSED]


def test_integrals_of_more_than_six_columns_stay_when_contacts_leave():
    """The wrench of those that stay is the sum over their columns."""
    controller, measured, X = vertices(9)
    alpha_d = np.linspace(2.0, 10.0, 9)
    stay = np.array([1, 1, 0, 1, 1, 1, 1, 1, 1])
    for _ in range(30):
        controller.tick(measured, osc.Reference(X, alpha_d=alpha_d, active=np.ones(9)))
    own = controller.records
    before = own.memory.columns.integral.copy()
    assert largest(before) > 0.1 and np.count_nonzero(before) == 3
    N = own.work.columns.N.copy()
    controller.tick(measured, osc.Reference(X, alpha_d=alpha_d, active=stay))
    r = int(own.work.rank)
    gain = controller.gains.force.integral * controller.dt
    step = gain * own.work.integral_scale * (own.work.alpha_d[:r] - own.work.alpha_meas[:r])
    found = (own.memory.force_sum[:r] - step) @ own.work.columns.N[own.kept()]
    assert_near(found, (before * stay) @ N, atol=1e-9)


def test_learned_normals_stay_with_their_contacts():
    """Also those of contacts that are not active for a while; without a named set they are lost."""
    rig = rig_of("two_contact_rod")
    plant, controller = start(rig)
    one = rig.references.at(0.0)
    controller.tick(plant.measure(), one)
    turn = controller.records.memory.columns.turn
    turn[:] = [[0.01, 0.02, 0.0], [0.02, 0.01, 0.0]]
    known = turn.copy()
    for active in ([1, 0], [0, 1], [1, 1]):
        controller.tick(plant.measure(), replace(one, active=np.array(active, dtype=float)))
        assert_near(turn, known, atol=1e-3)


def test_what_is_no_active_set_is_held_with_its_reason():
    controller, measured, X = vertices(3)
    good = osc.Reference(X, alpha_d=np.ones(3), active=np.ones(3))
    controller.tick(measured, good)
    wrong = replace(good, active=np.ones(4))
    held_tick(controller, "reference active: expected shape (3), got (4,)", measured, wrong)
    wrong = replace(good, active=np.array([1.0, np.nan, 0.0]))
    held_tick(controller, "reference active", measured, wrong)
    with raises(osc.InvalidInputError, match="reference active"):
        osc.Reference(X, active="edge")


def test_torques_go_gently_after_the_set_has_changed():
    controller, measured, X = vertices(3)
    desired = np.full(3, 8.0)
    last = None
    steps = []
    for k in range(40):
        active = [1.0, 1.0, k % 20 < 10]
        tau = controller.tick(measured, osc.Reference(X, alpha_d=desired, active=active))
        if last is not None:
            steps.append(largest((tau - last) / controller.chain.tau_max))
        last = tau
    assert 0.005 < max(steps[9:]) < 0.01


@parametrize("life", [None, osc.PhaseSettings(rise=1e-3)])
def test_a_contact_is_unloaded_before_it_leaves(life):
    """Its command goes to zero within the rise time of a step; the others are held meanwhile."""
    controller, measured, X = vertices(3, life, rise=0.1)
    work = controller.records.work
    desired = np.array([4.0, 8.0, 6.0])
    seen = []
    for k in range(320):
        active = np.array([1.0, 1.0, k < 180])
        reference = osc.Reference(X, alpha_d=desired * active, active=active)
        controller.tick(measured, reference)
        controller.records.memory.fresh = 0  # the readings are random, so they open no contact
        seen.append([*work.columns.goal, controller.phases()[2], work.integral_scale])
    *goals, phase, integral_scale = np.array(seen).T
    x = np.clip((np.arange(320) - 180) / 100, 0.0, 1.0)
    assert_near(goals[0][170:], 4.0)
    assert_near(goals[1][170:], 8.0)
    assert_near(
        goals[2][170:280], (6.0 * (1 - x) ** 3 * (1 + 3 * x + 6 * x**2))[170:280], atol=1e-9
    )
    assert_array_equal(phase[170:280], CLOSED)
    assert_array_equal(phase[282:], OPEN)
    assert_array_equal(integral_scale[170:], 1.0)


def test_a_contact_that_is_named_again_while_it_is_unloaded_stays():
    controller, measured, X = vertices(3, rise=0.1)
    goal = []
    for k in range(500):
        active = np.array([1.0, 1.0, not 200 <= k < 250])
        controller.tick(measured, osc.Reference(X, alpha_d=6.0 * active, active=active))
        goal.append(controller.records.work.columns.goal[2])
        assert controller.active[2]
    steps = np.abs(np.diff(goal[150:]))
    assert 1.0 < min(goal[150:]) < 3.0 and goal[-1] == approx(6.0)
    assert steps.max() < 2.5 * 6.0 / 100  # of a quintic: 1.9 times its mean slope


def test_force_integrals_go_on_while_the_force_of_a_new_contact_rises():
    """They hold the forces of the others, from which the landing takes."""
    controller, measured, X = vertices(3, rise=0.1)
    work = controller.records.work
    goal, integral_scale = [], []
    for k in range(330):
        active = np.array([1.0, 1.0, k >= 200])
        controller.tick(measured, osc.Reference(X, alpha_d=6.0 * active, active=active))
        goal.append(work.columns.goal[2])
        integral_scale.append(work.integral_scale)
    assert abs(goal[200] - 6.0) > 0.5 and goal[-1] == approx(6.0)
    assert min(integral_scale[:100]) == 0.0  # a step of all forces
    assert_array_equal(integral_scale[150:], 1.0)


def test_a_contact_leaves_at_once_where_another_one_takes_its_place():
    controller, measured, X = vertices(3, rise=0.1)
    for k in range(300):
        active = np.array([1.0, k < 200, k >= 200])
        controller.tick(measured, osc.Reference(X, alpha_d=6.0 * active, active=active))
        assert controller.active.tolist() == (active != 0).tolist()
    for k in range(100):  # and while it is unloaded
        active = np.array([1.0, k >= 20, 0.0])
        controller.tick(measured, osc.Reference(X, alpha_d=6.0 * active, active=active))
        assert controller.active.tolist() == [True, k >= 20, k < 20]


def test_unloading_ends_while_other_forces_step_on():
    """Each step of another contact lengthens the step to zero, for twice its rise time at most."""
    controller, measured, X = vertices(3, rise=0.1)
    here = []
    for k in range(700):
        active = np.array([1.0, 1.0, k < 200])
        alpha_d = active * np.array([8.0, 4.0 + 4.0 * (k // 20 % 2), 6.0])
        controller.tick(measured, osc.Reference(X, alpha_d=alpha_d, active=active))
        here.append(controller.active[2])
    assert here[250] and not any(here[405:])


# --- a beginning in the air -----------------------------------------------------------------------


def begun(engaged, **how):
    """A Panda that begins 5 mm above an edge: the phase of its contact and the true force."""
    rig = rig_of("panda_edge", "tare={standoff: 5 mm}", "control.life={}")
    plant = rig.plant()
    how |= {"posture": rig.q_contact, "life": osc.PhaseSettings(), "engaged": engaged}
    controller = osc.Controller(rig.model, rig.pairs, rig.gains, **how)
    controller.engaged = True
    goal = osc.Reference(rig.state.X_WO, alpha_d=[8.0])
    seen = []
    for _ in range(1500):
        tau = controller.tick(plant.measure(), goal)
        plant.command(tau, controller.dt)
        seen.append((int(controller.phases()[0]), float(plant.truth().alpha.sum())))
    assert controller.status is osc.Status.OK, controller.reason
    return np.array(seen).T


@parametrize("engaged", [True, False])
def test_a_controller_may_begin_in_the_air(engaged):
    """Contact is reported where there is one, and soon."""
    phases, force = begun(engaged, in_contact=False)
    touched = int(np.argmax(force > 1.0))
    assert touched > 300 and phases[0] == OPEN
    assert_array_equal(phases[1 : np.argmax(force > 0.0)], APPROACHING)
    assert_array_equal(phases[touched + 50 :], CLOSED)


def test_contacts_that_begin_open_need_phases():
    chain = panda_pair()
    with raises(osc.InvalidInputError, match="give life"):
        osc.Controller(chain, [], in_contact=False)
    assert (rig_of("two_contact_rod", "control.in_contact=no").controller().phases() == OPEN).all()
    for change in ("control.life=off", "plant.type=rigid"):
        with raises(osc.ScenarioError, match="begin open"):
            rig_of("two_contact_rod", "control.in_contact=no", change)


def test_every_contact_may_be_known():
    scene, ticks = sequence(6, 1)
    assert len(scene.contacts) == KNOWN and len(ticks) == 1
