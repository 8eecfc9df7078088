"""Small functions of the law, each against linear algebra or Pinocchio: forces, stops, stages.

What whole ticks show (the motion filter, commanded forces, yielding bodies) `test_law_kkt` judges.

Continues `test_law_parts.py`, in the same way.
"""

from dataclasses import replace
from math import inf
from types import SimpleNamespace as Record

import numpy as np
from law_calls import (
    allocation,
    commands,
    force_law,
    phases,
    reading,
    records,
    singular,
    tick,
    write,
)
from law_calls import command_filter as command
from numpy.linalg import cholesky, inv, norm, qr, solve
from numpy.testing import assert_array_equal
from rigs import UNLIMITED, assert_near, posed, random_faces, scara_pair
from samples import aligned, parametrize
from test_law import inputs, motion_of
from test_law_parts import SEEDS, rng_of

import osc_contact as osc
from osc_contact.law import records as at
from osc_contact.law.compiled import rows
from osc_contact.law.limits import TorqueLimits
from osc_contact.law.phases import APPROACHING, CLOSED
from osc_contact.law.reasons import NO_REASON
from osc_contact.law.records import Rows, new_model, views
from osc_contact.law.saturation import settle
from osc_contact.law.tick import BAD_INPUT, MOVING

# --- forces ---------------------------------------------------------------------------------------


def command_force(alpha_d, felt, speed, integral, least=-inf):
    """α_u and the integral of the second of two columns; the first and what is beyond differ."""
    t = records(contacts=3, columns=3, integral_force=5.0)
    t.model.columns.contact = range(3)
    columns = {"alpha_d": alpha_d, "felt": felt, "speed": speed, "least": least}
    for name, value in (columns | {"gain": 20.0, "damping": 100.0}).items():
        write(t.work, **{name: [1.0, value, 2.0]})
    write(t.memory, force_sum=[1.0, integral, 2.0], force_rank=2)
    write(t.work, rank=2, count=2, dt=1e-3, kept=range(3))
    force_law.command_force(t)
    assert t.work.force_next[2] == t.work.alpha_u[2] == 0.0 and t.work.force_next[0] == 1.0
    return (t.work.alpha_u[1], t.work.force_next[1])


@parametrize(
    "given, expected",
    {
        (8.0, 6.0, 0.01, 0.5): (8.0 + 0.5 + 0.04 - 1.0, 0.54),
        (8.0, 6.0, -0.01, 0.5): (8.0 + 0.5 + 0.04 + 1.0, 0.54),
        # the integral stays within 5 N or one and a half times the command
        (1.0, 0.0, 0.0, 5.0): (6.0, 5.0),
        (8.0, -990.0, 0.0, 0.0): (20.0, 12.0),
        (-8.0, 990.0, 0.0, 0.0): (-20.0, -12.0),
        (1.0, 900.0, 0.0, 0.0): (-4.0, -5.0),
        # no less than α_min, or a tenth of the command; the integral rests then
        (8.0, 9.0, 0.1, -1.0, 0.5): (0.5, -1.0),
        (8.0, 7.0, 0.1, -1.0, 0.5): (0.5, -0.98),
        (2.0, 7.0, 0.1, -1.0, 0.5): (0.2, -1.0),
        (8.0, 9.0, 0.06, -1.0, 0.5): (0.98, -1.02),
    },
)
def test_the_force_law(given, expected):
    assert_near(command_force(*given), expected, rtol=1e-12)


def command_face(felt, last, phase=CLOSED, dependent=False, desired=(4.0,) * 4, **of_model):
    """α_u and integrals of a face's three columns, and of the vertex after them."""
    t = records(contacts=2, columns=4, **{"integral_force": 8.0} | of_model)
    t.model.columns.contact = [0, 0, 0, 1]
    t.model.bodies.face = [1, 0]
    t.memory.contacts.phase = phase
    given = {"speed": 0.0, "gain": 20.0, "damping": 0.0, "least": 0.5}
    for name, value in given.items():
        write(t.work, **{name: [value] * 4})
    write(t.work, rank=4, count=4 + dependent, dt=1e-3, kept=range(4))
    write(t.work, felt=[*felt, 4.0], alpha_d=desired)
    write(t.memory, force_sum=[*last, 1.0], force_rank=4)
    force_law.command_force(t)
    assert (t.work.alpha_u[3], t.work.force_next[3]) == (desired[3] + 1.0, 1.0)
    return (t.work.alpha_u[:3].copy(), t.work.force_next[:3].copy())


@parametrize(
    "felt, last, expected",
    {
        # as columns alone, while all are free
        ((2.0, 5.0, 8.0), (0.0, 0.5, -0.5), (0.04, 0.48, -0.58)),
        # all rests on the first corner, whose command is at its floor of 0.4 N
        ((12.0, 0.0, 0.0), (-3.6, 1.8, 1.8), (-3.6, 1.8, 1.8)),
        # and too much of it: the common part, here 0, falls by 20/s times the mean error of 1 N
        ((15.0, 0.0, 0.0), (-3.6, 1.8, 1.8), (-3.6, 1.79 - 0.02, 1.79 - 0.02)),
        # too little
        ((9.0, 0.0, 0.0), (-3.6, 1.8, 1.8), (-3.6, 1.83, 1.83)),
        # two corners at their floors: the third bears what is commanded
        ((6.0, 6.0, 0.0), (-3.6, -3.6, 7.2), (-3.6, -3.6, 7.2)),
        # no integral above nine tenths of its bound: 7.2 N
        ((0.0, 0.0, -40.0), (3.0, 3.0, 7.2), (3.52, 3.52, 7.2)),
    },
)
def test_the_commands_of_a_face_have_an_exact_sum(felt, last, expected):
    commands, integrals = command_face(felt, last)
    mean = np.mean(last) + 0.02 * (4.0 - np.mean(felt))
    assert_near(integrals.sum(), 3.0 * mean, atol=1e-12, rtol=0)
    assert_near(integrals, expected, atol=0.02, rtol=0)
    assert_near(commands, 4.0 + integrals, rtol=1e-12)
    assert commands.min() > 0.4 - 1e-9 and integrals.max() < 7.2 + 1e-9


@parametrize(
    "other",
    [
        {"phase": APPROACHING},
        {"dependent": True},
        {"desired": (4.0, 0.0, 4.0, 4.0)},
    ],
)
def test_columns_of_a_face_are_commanded_alone_unless_it_presses(other):
    desired = np.array(other.get("desired", (4.0,) * 4)[:3])
    felt, last = np.array([9.0, 5.0, 0.0]), np.array([-3.5, 0.0, 1.8])
    commands, integrals = command_face(felt, last, **other)
    free = last + 0.02 * (desired - felt)
    floors = np.minimum(0.5, 0.1 * desired)
    low = desired + free < floors
    assert_near(integrals, np.where(low, np.maximum(free, last), free), rtol=1e-12)
    assert_near(commands, np.maximum(desired + free, floors), rtol=1e-12)


def test_a_face_at_its_floor_keeps_its_common_integral():
    """And it is limited as that of a column is: here to 8 N."""
    commands, integrals = command_face((12.0, 12.0, 12.0), (-3.7, -3.7, -3.7))
    assert_near(integrals, -3.7, rtol=1e-12)
    assert_near(commands, 0.4, rtol=1e-12)
    _, integrals = command_face((0.0, 0.0, 0.0), (8.0, 8.0, 8.0))
    assert_near(integrals, 8.0, rtol=1e-12)


@parametrize("dependent", [False, True])
def test_laws_of_contacts_are_those_of_their_columns(dependent):
    """Rows: gain, damping, least force and brake."""
    laws = np.array([[3, 2, 1, 0], [5, 9, 4, 99], [0.1, 0.2, 0.3, 0.9], [0.7, 0.6, 0.8, 9]])
    names = ("gain", "damping", "least", "brake")
    t = records(contacts=4, columns=4)
    t.model.columns.contact = [1, 0, 2, 3]
    t.model.bodies.pushes = 1
    t.work.chosen[:3] = [2, 0, 1]
    write(t.work, rank=2, count=3 if dependent else 2, kept=[0, 2], **dict.fromkeys(names, 7.0))
    write(t.memory.contacts, **dict(aligned(names, laws)))
    force_law.contact_laws(t)
    expected = [[1.0, 1.0], [9.0, 9.0], [-inf, -inf], [0.8, 0.8]] if dependent else laws[:, [1, 2]]
    for name, row in aligned(names, expected):
        assert_array_equal(getattr(t.work, name)[:3], [*row, 7.0])


@parametrize("pushes, desired, holds", [(0, 0.0, True), (0, 2.0, False), (1, 0.0, False)])
def test_a_contact_that_holds_without_a_desired_force_has_gains_of_its_own(pushes, desired, holds):
    """And its whole speed is braked; another column of the contact decides, too."""
    t = records(contacts=1, columns=2, hold_gain=0.5, hold_brake=60.0)
    t.model.bodies.pushes = pushes
    write(t.work, rank=1, count=2, kept=[0], chosen=[0, 1], speed=[0.25])
    t.work.columns.alpha_d = [0.0, desired]
    write(t.memory.contacts[0], gain=6.0, damping=1.0, brake=8.0)
    t.memory.columns.drift = 0.125
    t.work.rank = t.work.count = 1
    force_law.contact_laws(t)
    assert (t.work.gain[0], t.work.damping[0], t.work.brake[0]) == (
        (0.5, 1.0, 60.0) if holds else (6.0, 1.0, 8.0)
    )
    commands.brake_contacts(t)
    assert t.work.brake[0] == (60.0 * 0.25 if holds else 8.0 * 0.125)


def test_a_face_is_braked_where_its_corners_move_apart():
    """The mean of its lasting speeds is sliding along a tilted face, and is not braked."""
    t = records(contacts=2, columns=4)
    t.model.columns.contact = [0, 0, 0, 1]
    t.model.bodies.face = [1, 0]
    t.model.bodies.pushes = 1
    write(t.work, rank=4, kept=range(4), speed=[0.5, 0.25, 0.75, 0.5], brake=[8.0] * 4)
    t.memory.columns.drift = [0.5, 0.25, 0.75, 0.25]
    commands.brake_contacts(t)
    assert t.work.brake[:4].tolist() == [0.0, -2.0, 2.0, 2.0]


def test_bodies_do_not_yield_while_their_motion_is_unknown():
    """Results of an older tick are not used."""
    t = records(contacts=1, columns=1)
    write(t.work, rank=1, N_factor=np.eye(1), N_basis=np.ones((1, 6)), out_T=np.eye(6))
    pushes = []
    for found in (0.0, 1.0):
        t.work.yields[:] = found
        pushes.append(reading.reading_of_force(t, (1.0, 2.0, 3.0), 0))
    assert_array_equal(*pushes)


# --- singular postures ----------------------------------------------------------------------------


@SEEDS
def test_a_posture_may_be_singular_where_its_inertia_beside_the_reference_is_large(seed):
    rng = rng_of(seed)
    root = rng.standard_normal((6, 6))
    reference = 10.0 ** rng.uniform(-2.0, 1.0, 6)
    Lambda = root @ root.T
    beside = np.sqrt((Lambda**2 / np.outer(reference, reference)).sum())
    Lambda *= 0.3**-2 / beside  # at the limit: 1/χ² = 1/0.3²
    t = records(lightness=1.0 / reference)
    arm = Record(full_rank=5)
    for factor, kept, expected in ((0.999, 5, False), (1.001, 5, True), (1e-9, 4, True)):
        own = Record(Lambda=factor * Lambda, n_kept=kept)
        assert singular.may_be_singular(t, arm, own) == expected


@parametrize("chi", [0.0, 1e-10])
@parametrize("n", [2, 4, 7])
def test_a_motion_that_does_nothing_is_any_that_is_new(n, chi):
    """The axes before it are spanned already: only the last ones are new."""
    rng = rng_of(n)
    small = singular._unit_row
    for k in range(n):
        X = np.zeros((n + 1, n + 2))
        X[:k, :k] = qr(rng.standard_normal((k, k)))[0]
        if k == n - 1 and n > 2:
            X[:k, :n] = qr(rng.standard_normal((n, n)))[0][:k]
        X[k] = chi * rng.standard_normal(n + 2)
        behind = X[k, n:].copy()
        small(X, k, n, chi)
        assert_near(X[: k + 1, :n] @ X[: k + 1, :n].T, np.eye(k + 1), atol=1e-12)
        assert_array_equal(X[k, n:], behind)
    X = rng.standard_normal((3, 7))
    expected = X[1, :5] / 0.3
    small(X, 1, 5, 0.3)
    assert_near(X[1, :5], expected, rtol=1e-12)


@SEEDS
@parametrize("gone", [0.0, 1.0])
def test_lost_motions_are_left_to_the_posture(seed, gone):
    """νᵀτ = (1 − φ) νᵀ(h + M q̈) for ν with νᵀMν = 1; where it is gone, all of it."""
    rng = rng_of(seed)
    n = 3
    lo = 2
    root = rng.standard_normal((n, n))
    M, h, tau, rest = root @ root.T, *rng.standard_normal((3, n))
    q, v, posture = rng.standard_normal((3, lo + n))
    modes = inv(cholesky(M)).T[:, :2].T
    t = records(joints=lo + n, posture_stiffness=3.0, retreat_damping=7.0)
    t.model.joints.posture = posture
    write(t.input, q=q, v=v)
    joints = t.work.joints[lo:]
    write(joints, M=M, h=h, tau=tau, rest=rest)
    own = Record(n_lost=2, mode=modes, gone=[gone, gone], share=[0.3, 0.8])
    allocation._retreat_from_lost(t, Record(first=lo, end=lo + n), own)
    back = h + M @ (3.0 * (posture - q) - 7.0 * v)[lo:]
    expected = rest.copy()
    for mode, share in aligned(modes, own.share):
        expected += mode @ (back - tau if gone else (1.0 - share) * back) * (M @ mode)
    assert_near(joints.rest, expected, atol=1e-9, rtol=1e-9)


# --- torques --------------------------------------------------------------------------------------


@SEEDS
def test_rows_that_those_before_nearly_span_are_factored_too(seed):
    """Z = A R⁻¹Aᵀ; the last pivot is less than 1e-7 of its row."""
    rng = rng_of(seed)
    n = 9
    A = rng.standard_normal((8, n))
    A[7] = rng.standard_normal(7) @ A[:7] + 1e-3 * A[7]
    t = records(arms=1, joints=n)
    t.model.arms.end = n
    t.model.joints.effort = rng.uniform(0.5, 2.0, n)
    t.work.joints.J_bar[:] = A[:6].T
    write(t.work, effort=A[:6] * t.model.joints.effort @ A[:6].T, extra=A[6:])
    assert allocation.factor_effort(t) and allocation.add_row(t, 0) and allocation.add_row(t, 1)
    R = qr((A * np.sqrt(t.model.joints.effort)).T)[1]
    expected = (R * np.sign(np.diag(R))[:, None]).T
    assert_near(np.tril(t.work.factor[:8, :8], -1), np.tril(expected, -1), atol=1e-9)
    assert_near(1.0 / np.diag(t.work.factor)[:8], np.diag(expected), rtol=1e-8)


def test_torques_are_given_unless_one_is_beyond_its_limit_or_no_number():
    t = records(joints=3)
    t.model.joints.motor = [1, -1, 0]
    t.model.joints.tau_max = 2.0
    for torques, excess, finite in (
        ((1.9, 99.0, -2.0), False, True),
        ((2.1, 0.0, 0.0), True, True),
        ((0.0, 0.0, -2.1), True, True),
        ((np.nan, 0.0, 0.0), False, False),
        ((0.0, 0.0, -inf), False, False),
        ((0.0, np.nan, 0.0), False, True),
    ):
        t.work.tau[:] = 7.0
        t.work.joints.tau = torques
        with np.errstate(invalid="ignore"):
            assert allocation.limit_torques(t) == (excess, finite)
        given = finite and not excess
        assert t.work.tau.tolist() == ([torques[2], torques[0], 7.0] if given else [7.0] * 3)


# --- columns of N in the turned coordinates -------------------------------------------------------


def judged(N, Lambda, held, m=0):
    """The reason of `require_reachable`, which column, and what is left."""
    t = records(held=held)
    Lambda_S = Lambda + held * np.eye(6)
    write(t.work, rank=len(N), locked=m, N_t=7.0, Lambda=Lambda_S, where=-1, reason_amount=-1.0)
    t.work.N_t[: len(N)] = N
    return (command.require_reachable(t), t.work, t)


@parametrize("held", [0, 1])
def test_columns_on_which_the_arms_can_push(held):
    rng = rng_of(held)
    root = rng.standard_normal((6, 6))
    Lambda = root @ root.T + np.eye(6)
    assert judged(np.zeros((0, 6)), Lambda, held)[0] == NO_REASON
    for m in (0, 2, 5):
        N = rng.standard_normal((min(3, 6 - m), 6))
        reason, work, t = judged(N, Lambda, held, m)
        assert (reason, command._judge_reach(t)) == (NO_REASON, NO_REASON)
        L = cholesky((Lambda + held * np.eye(6))[m:, m:])
        seen = solve(L, N[:, m:].T)
        pivots = np.abs(np.diag(qr(seen)[1]))
        assert_near(work.reason_amount, min(pivots / norm(seen, axis=0)), rtol=1e-7)
        for a in range(len(N) if m else 0):
            hidden = N.copy()
            hidden[a, m:] = L @ np.full(6 - m, 0.5e-5)  # seen with 0.25e-10 (6 − m) of its square
            reason, work, _ = judged(hidden, Lambda, held, m)
            assert (reason, work.where) == (command.UNREACHABLE, a)
            assert_near(work.reason_amount, (6 - m) * 0.25e-10 / (hidden[a] @ hidden[a]), rtol=1e-6)
    assert judged(N, Lambda, held, 6)[0] == command.UNREACHABLE
    # 1/Λ along the column, beside 1: on either side of 1e-9
    for mobility, expected in ((0.5e-9, command.UNREACHABLE), (2e-9, NO_REASON)):
        heavy = np.eye(6) / 7.0
        heavy[3, 3] = 1.0 / mobility
        reason, work, _ = judged(np.eye(6)[[1, 3]], heavy, held)
        assert reason == expected and (expected == NO_REASON or work.where == 1)
    # columns that differ by so much
    for apart, expected in ((0.3e-10, command.INSEPARABLE), (3e-10, NO_REASON)):
        N = np.zeros((2, 6))
        N[:, 1] = 1.0
        N[1, 4] = apart
        assert judged(N, np.eye(6), held)[0] == expected
    none = np.diag([1.0, 1.0, 1.0, 1.0, 0.0, 1.0])
    assert judged(np.eye(6)[:2], none, held)[0] == (NO_REASON if held else command.BAD_METRIC)


def test_a_metric_that_is_not_definite_is_reported():
    t = records(contacts=1, columns=1, metric=at.BY_MATRIX)
    write(t.work, rank=1, B_inv_t=-np.eye(6))
    assert command.filter_motion(t) == command.BAD_METRIC


# --- stages ---------------------------------------------------------------------------------------


@parametrize("arms", [1, 3])
def test_every_number_that_comes_in_is_looked_at(arms):
    """Squeeze is one number for up to two arms, and one for each bar of more."""
    t = records(arms=arms, joints=2, contacts=2, columns=3)
    given = {name: getattr(t.input, name) for name in ("q", "v", "wrenches", "alpha_d", "touched")}
    given |= {name: getattr(t.input, name) for name in ("X_WD", "V_D", "A_D")}
    given["squeeze"] = t.memory.squeeze
    for name, x in given.items():
        for i in range(x.size):
            for bad in (np.nan, inf, -inf):
                x.flat[i] = bad
                for on in (False, True):
                    counts = {"alpha_d": on, "touched": on}.get(name, True)
                    with np.errstate(invalid="ignore"):
                        assert tick.is_finite(t, on, on) != counts, (name, i)
                x.flat[i] = 0.0
    assert tick.is_finite(t, True, True)


def a_tick():
    """A controller of two contacts after a tick, and what the law was given."""
    chain = scara_pair()
    rng = rng_of(0)
    q, v, X = posed(chain, rng)
    pairs = random_faces(X, 2, rng)
    controller = osc.Controller(chain, pairs, safety=UNLIMITED)
    own = controller.records
    run = own.run
    seen = []
    own.run = lambda given, *how: seen.append(given) or run(given, *how)
    measurement, reference = inputs(chain, q, v, rng, 2, motion_of(rng, 2))
    controller.tick(measurement, replace(reference, active=np.ones(2)))
    assert own.memory.reason == NO_REASON and own.memory.engaged
    own.rows.job.switches = MOVING
    return (rows(), (own.rows.raw, 0, seen[-1]), own.memory)


def test_inputs_of_other_sizes_are_none():
    tick, given, memory = a_tick()
    for place, x in enumerate(given[2]):
        for other in (x[:-1], np.concatenate((x, x[:1]))):
            arrays = list(given[2])
            arrays[place] = np.ascontiguousarray(other)
            tick(*given[:2], tuple(arrays))
            assert (memory.status, memory.reason) == (at.HELD, BAD_INPUT), place


@parametrize("place", [0, 1])
@parametrize("count", [-1, 1])
def test_joints_of_another_number_are_not_read(place, count):
    """What stands beyond their end, or one of them more, moves nothing that is held."""
    found = []
    for more in (0.01, -2.0):
        tick, given, memory = a_tick()
        arrays = list(given[2])
        x = np.append(arrays[place], np.zeros(2))
        n = len(arrays[place]) + count
        x[n if count < 0 else n - 1 :] = more
        x[0] += more if count > 0 else 0.0
        arrays[place] = x[:n]
        torques = []
        for _ in range(40):
            tick(*given[:2], tuple(arrays))
            torques.append(memory.torques.copy())
        found.append((torques, memory.state))
    assert_array_equal(found[0][0], found[1][0])
    assert found[0][1] == found[1][1] == at.SAFE_STOP


def command_of(flags=0, of_memory=None, integral=2.0, **of_work):
    """The records after a tick whose columns and motions are alone, and what was called."""
    called = {}
    decide = tick.altered(
        "command",
        filter_motion=lambda t: NO_REASON,
        command_object=lambda t: None,
        transfer_integral=lambda t: called.update(handed=True),
        reduce_motion=lambda *given: called.update(reduced=True),
    )
    t = records(0, 0, 2, 2, integral_force=5.0, integral_motion=0.8, stiffness=3.0, damping=4.0)
    t.model.integral = integral
    t.model.columns.contact = range(2)
    write(
        t.work,
        kept=range(2),
        rank=2,
        dt=1e-3,
        gain=[20.0, 30.0],
        alpha_d=[8.0, 9.0],
        felt=[6.0, 10.0],
    )
    write(t.work, speed=[0.01, 0.02], damping=[100.0, 0.0], least=-inf, alpha_u=7.0, a_u=7.0)
    write(t.work, motion_next=[100.0, -900.0, 900.0], error=np.arange(6.0), **of_work)
    write(t.memory, force_sum=[0.5, -0.5], force_rank=2, motion_sum=0.1)
    write(t.memory, **(of_memory or {}))
    write(t.input, V_D=1.0, A_D=1.0)
    assert decide(t, flags) == NO_REASON
    return (t.work, t.memory, called)


def test_laws_and_integrals_of_a_tick():
    """Whole ticks are those of test_law_kkt; here: bounds, new columns, laws of the user."""
    work, _, _ = command_of()
    assert_near(work.motion_next, [0.2, -0.4, 0.4, 0.1, 0.1, 0.1])  # no further than 0.8 / 2
    assert_near(
        command_of(of_memory={"force_rank": 1})[0].force_next[:2], [0.04, -0.03]
    )  # begins anew
    assert_near(command_of(of_memory={"wrench_missing": 1})[0].force_next[:2], [0.5, -0.5])
    assert_near(command_of(integral=0.0)[0].motion_next, [0.2, -0.8, 1.0, 0.1, 0.1, 0.1])
    _, memory, called = command_of(of_memory={"hand_over": 1})
    assert called["handed"] and memory.hand_over == 0
    for lost, locked, reduced in ((1, 5, True), (1, 6, False), (0, 5, False)):
        assert ("reduced" in command_of(n_lost=lost, locked=locked)[2]) == reduced
    work, _, _ = command_of(tick.OWN_FORCE)
    assert_near(work.alpha_u[:2], [8.0 - 1.0, 7.0])  # approached; the user's own
    assert_near(work.force_next[:2], [0.5, -0.5])
    assert_near(command_of(tick.OWN_FORCE, {"force_rank": 1})[0].force_next, 0.0)
    assert_near(command_of(tick.OWN_FORCE, {"by_column": 1})[0].force_next, 0.0)
    assert_near(command_of(tick.OWN_MOTION)[0].a_u, 7.0)


# --- phases ---------------------------------------------------------------------------------------


@parametrize(
    "phase, pushes, since, gap, speed, expected",
    [
        (CLOSED, 1, 9.0, 0.0, 0.0, 8.0),
        (CLOSED, 1, 0.1, 0.0, 0.0, 2.0 + 0.25 * 6.0),
        (CLOSED, 0, 0.1, 0.0, 0.0, 8.0),
        (APPROACHING, 0, 0.1, 0.0, 0.0, 0.5),
        (APPROACHING, 1, 0.1, 0.0, 0.0, 0.5),
        (APPROACHING, 1, 0.1, 0.0, -0.004, 0.5 + 0.8),
        (APPROACHING, 1, 0.1, 0.0, 0.1, 2.0),
        (APPROACHING, 1, 0.1, 0.006, 0.0, 2.0),
        (APPROACHING, 1, 0.1, 0.006, 0.02, 6.0),
        (APPROACHING, 1, 0.1, 0.006, 0.1, 8.0),
        (APPROACHING, 1, 0.1, 9.0, 0.1, 20.0),
        (APPROACHING, 1, 9.0, 9.0, 0.1, 0.0),
    ],
)
def test_goals_of_contacts(phase, pushes, since, gap, speed, expected):
    """K_a v_a = 2 N while it is approached, from 0.5 N on; faster back over a known gap."""
    near = phase == APPROACHING
    for slow, fast in ((speed, -9.0), (9.0, speed), (speed, speed)):  # the slower one counts
        t = records(contacts=1, columns=1, force_gain=3.0, force_damping=5.0, force_brake=0.5)
        write(t.model, approach_damping=200.0, approach_speed=0.01, least_force=0.4, travel=0.05)
        write(t.model, force_on=1.0, rise=0.4, return_speed=0.1)
        t.model.bodies.pushes[0] = pushes
        contact = t.memory.contacts[0]
        contact.phase = phase
        contact.since = since
        write(t.memory.columns[0], gap=gap, filtered_speed=slow, speed=fast)
        t.work.goal[0] = 8.0
        phases.set_goals(t)
        assert_near(t.work.goal[0], expected)
        found = (contact.active, contact.gain, contact.damping, contact.brake)
        assert found == ((1, 0.0, 200.0, 0.0) if near else (1, 3.0, 5.0, 0.5))
        assert contact.least == (0.4 if pushes and not near else -inf)


@parametrize("phased", [0, 1])
def test_phases_keep_what_was_measured(phased):
    t = records(contacts=1, columns=2, phased=phased, lag=0.02, period=1e-3)
    t.memory.columns.known = 1
    tick.altered("remember", phases=phases)(t)
    assert (t.memory.columns.known == 1 - phased).all(), "nothing is in contact"


# --- torques beyond the motors --------------------------------------------------------------------


def settled(ticked, n_arms=2, n_internal=1, rate=100.0):
    """Torques and squeeze after `settle` with the solution 6 and −1 N m in place of 0 and 0."""
    rows = Rows(new_model(n_arms, 2, 2, columns=1))
    model, memory, work, _ = views(rows)
    write(model, torque_rate=rate, phase_rate=1.0, period=1e-3)
    write(model.joints, motor=[1, 0], tau_max=[10.0, 30.0])
    write(work, n_internal=n_internal, rank=1, dt=1e-3, force_next=[3.0], gain=[20.0])
    work.bars[:] = 8.0
    work.basis[:, :1] = 0.6
    memory.ticked = ticked
    program = TorqueLimits(2, 1, 1)
    write(program.program, tau=[6.0, -1.0], lost_force=[50.0], lost_squeeze=[5.0])
    settle(rows.raw, 0, 0, program.raw)
    assert_near(memory.force_sum[0], 3.0 - 20.0 * 1e-3 * 50.0)
    assert memory.force_rank == 1
    return (memory.torques.copy(), work.bars.tolist())


def test_torques_within_the_limits_change_no_faster_than_others():
    assert_near(settled(1)[0], [6.0, -1.0])  # the first tick has none before it
    assert_near(settled(2)[0], [3.0, -0.5])  # 100/s of 30 N m, in 1 ms
    assert_near(settled(2, rate=1e9)[0], [6.0, -1.0])
    assert settled(2)[1] == [5.0]
    assert settled(2, n_internal=0)[1] == [8.0], "what is lost is of an older tick"
    assert settled(2, n_arms=3)[1] == [5.0] * 3
