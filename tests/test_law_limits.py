"""Motor limits as array functions: the optimum in exact fractions, on cases of every size."""

import sys
from dataclasses import dataclass, fields, replace
from fractions import Fraction

import daqp
import numpy as np
from law_calls import write
from numpy.random import default_rng
from numpy.testing import assert_array_equal
from pytest import mark, param, raises
from rigs import assert_near, largest, within
from samples import aligned, parametrize

import osc_contact as osc
from osc_contact.law.limits import TorqueLimits

FORCE = 1e-3
SQUEEZE = 1e-5
TORQUE = 1e-7
BEYOND = 1e2
K_MAX = 9
S_MAX = 3


@dataclass(frozen=True)
class Case:
    """Operands of `TorqueLimits`; six coordinates, the last d of them free."""

    d: int
    desired: np.ndarray
    tau_max: np.ndarray
    G: np.ndarray
    Lambda: np.ndarray
    N: np.ndarray
    pushed: np.ndarray
    Phi_e: np.ndarray
    alpha: np.ndarray
    share: np.ndarray
    floor: np.ndarray
    E: np.ndarray
    carried: np.ndarray
    mass: float = 1.5

    @property
    def scale(self):
        known = np.isfinite(self.tau_max)
        return np.where(known, self.tau_max, self.tau_max[known].max(initial=0.0) or 1.0)


def random_case(
    rng,
    n=8,
    d=None,
    r=None,
    k=None,
    s=None,
    *,
    apart=None,
    passive=0,
    weak=1.0,
    endless=0,
    bodies=False,
):
    """`apart`: of columns of N. `passive`: contacts more than forces. `bodies`: one per contact."""
    d = int(rng.integers(3, 7)) if d is None else d
    r = int(rng.integers(0, d + 1)) if r is None else r
    s = int(rng.choice([0, 1, 3])) if s is None else s
    root = rng.standard_normal((6, 6))
    N = rng.standard_normal((r, 6))
    friction_wrenches = 0.3 * rng.standard_normal((r, 6)) * rng.integers(0, 2)
    if apart and r > 1:
        N[-1] = N[0] + apart * N[-1]
        friction_wrenches[-1] = friction_wrenches[0] + apart * friction_wrenches[-1]
    shape = (
        np.diag(rng.uniform(0.1, 1.0, r))
        if bodies
        else 0.3 * N @ root @ root.T @ (N + friction_wrenches).T
    )
    alpha = rng.uniform(5.0, 20.0, r)
    share = np.eye(r)
    if passive and r:
        R = rng.uniform(0.2, 1.0, (r, r + passive))
        R[:, -1] = R[:, 0]  # two contacts in one place: dependent floors
        alpha = R @ rng.uniform(5.0, 20.0, r + passive)
        share = R.T @ np.linalg.inv(R @ R.T)
    share = share[len(share) - (int(rng.integers(0, len(share) + 1)) if k is None else k) :]
    tau_max = rng.uniform(5.0, 80.0, n)
    desired = rng.standard_normal(n) * tau_max * min(1.0, np.sqrt(weak))
    tau_max *= weak
    tau_max[rng.permutation(n)[:endless]] = np.inf
    return Case(
        d,
        desired,
        tau_max,
        rng.standard_normal((n, 6)),
        np.eye(6) + root @ root.T / 6,
        N,
        N + friction_wrenches,
        shape,
        alpha,
        share,
        np.minimum(1.0, share @ alpha),
        rng.standard_normal((s, n)),
        rng.standard_normal((s, 6)),
    )


def two_forces(seed, **how):
    """One that moves in all ways."""
    return random_case(default_rng(seed), d=6, r=2, k=2, s=1, **how)


MADE = {}  #: by the number of motors


def solve(case):
    """Solve a case with arrays that other cases have used before."""
    n = len(case.desired)
    r = len(case.alpha)
    s = len(case.E)
    limits = MADE.setdefault(n, TorqueLimits(n, K_MAX, S_MAX))
    write(limits.program, **{x.name: getattr(case, x.name) for x in fields(case) if x.name != "d"})
    write(limits.program, d=case.d, r=r, k=len(case.floor), s=s)
    short = limits.solve()
    assert not limits.lost_force[r:].any() and not limits.lost_motion[: 6 - case.d].any()
    lost = (limits.lost_force[:r], limits.lost_motion[6 - case.d :], limits.lost_squeeze[:s])
    return (limits.tau.copy(), limits.at_limit.copy(), *(x.copy() for x in lost), short)


# An oracle in fractions ---------------------------------------------------------------------------


def fractions(A):
    return np.array([Fraction(float(x)) for x in np.ravel(A)], dtype=object).reshape(np.shape(A))


def eliminate(A, B):
    """A⁻¹B, exactly."""
    M = np.hstack((A, B))
    for i in range(len(A)):
        p = i + int(np.argmax([abs(x) for x in M[i:, i]]))
        M[[i, p]] = M[[p, i]]
        M[i] = M[i] / M[i, i]
        for j in range(len(A)):
            if j != i and M[j, i]:
                M[j] = M[j] - M[j, i] * M[i]
    return M[:, len(A) :]


def exact_optimum(case, tau):
    """Torques, force, motion and squeeze lost, `short`; all KKT conditions are kept exactly.

    Limits are springs that give way by 1e-40 per unit of multiplier: where that is seen, no
    torques keep all of them. `tau`: where the search for the active ones begins.
    """
    m = 6 - case.d
    n = len(tau)
    k = len(case.floor)
    scale = fractions(case.scale)
    N = fractions(case.N)
    floor = fractions(case.floor)
    free = eliminate(
        fractions(case.Lambda[m:, m:]),
        np.hstack((fractions(case.G[:, m:].T) * scale, fractions(case.pushed[:, m:].T))),
    )
    free, yielding = free[:, :n], free[:, n:]
    force = eliminate(N[:, m:] @ yielding + fractions(case.Phi_e), N[:, m:] @ free)
    motion = free - yielding @ force
    squeeze = fractions(case.E) * scale - fractions(case.carried[:, m:]) @ motion
    H = motion.T @ motion + Fraction(FORCE) * (N.T @ force).T @ (N.T @ force)
    H = H + Fraction(SQUEEZE) / Fraction(case.mass) * (squeeze.T @ squeeze)
    H = H / (np.trace(H) / n) + Fraction(TORQUE) * fractions(np.eye(n))
    share = fractions(case.share)
    forces = share @ force
    unit = fractions(np.sqrt((forces.astype(float) ** 2).sum(axis=1)))
    A = np.vstack((fractions(np.eye(n)), forces / unit[:, None]))
    desired = fractions(case.desired)
    tau_max = fractions(np.minimum(case.tau_max, 1e12))  # of motors without a limit
    ends = np.hstack(((tau_max - desired) / scale, fractions(np.zeros(k))))
    least = np.minimum((floor - share @ fractions(case.alpha)) / unit, 0)
    starts = np.hstack(((-tau_max - desired) / scale, least))
    first = {i: int(np.sign(tau[i])) for i in range(n) if abs(tau[i]) >= case.tau_max[i]}
    for soft in (Fraction(1, 10**40), Fraction(1, int(BEYOND))):
        give = [Fraction(1, 10**40)] * n + [soft] * k
        z, broken = active_limits(H, A, starts, ends, give, dict(first))
        if broken < Fraction(1, 10**20) or soft > Fraction(1, 1000):
            lost = [-(rows @ z).astype(float) for rows in (force, motion, squeeze)]
            return ((desired + scale * z).astype(float), *lost, soft > Fraction(1, 1000))
    raise AssertionError


def active_limits(H, A, starts, ends, give, sides):
    """z of min zᵀHz with starts ≤ Az ≤ ends, and how far the limits gave way."""
    n = len(H)
    rng = default_rng(0)
    for step in range(300):
        rows = sorted(sides)
        C = A[rows]
        right = fractions(np.zeros((n + len(rows), 1)))
        slack = fractions(np.zeros((len(rows), len(rows))))
        for j, i in enumerate(rows):
            right[n + j] = ends[i] if sides[i] > 0 else starts[i]
            slack[j, j] = give[i]
        answer = eliminate(np.block([[H, -C.T], [C, slack]]), right)[:, 0]
        z = answer[:n]
        x = A @ z
        wrong = np.maximum(x - ends, starts - x)  # beyond a limit, or pulled by it
        most = max([wrong[i] for i in rows], default=Fraction(0))
        wrong[rows] = [answer[n + j] * sides[i] for j, i in enumerate(rows)]
        if max(wrong) <= 0:
            return (z, most)
        i = int(np.argmax(wrong) if step < 15 else rng.choice(np.flatnonzero(wrong > 0)))
        if sides.pop(i, 0) == 0:  # chance ends what would go round
            sides[i] = 1 if x[i] > ends[i] else -1
    raise AssertionError("the active limits were not found")


def agree(case, tolerance):
    """All that is found as in the exact optimum; returns whether forces leave their range."""
    tau, at_limit, force, motion, squeeze, short = solve(case)
    expected, *lost, there = exact_optimum(case, tau)
    assert short == there and within(tau, case.tau_max)
    assert largest((tau - expected) / case.scale) < tolerance
    near = np.abs(expected) >= case.tau_max * (1.0 - 1e-9)
    assert_array_equal(at_limit, near)
    for got, exact in aligned((force, motion, squeeze), lost):
        assert_near(got, exact, atol=tolerance * (1.0 + largest(exact)), rtol=0)
    return short


@parametrize(
    "how, tolerance",
    [
        ({}, 1e-11),
        ({"weak": 0.05}, 1e-11),
        ({"d": 6, "r": 6}, 1e-9),
        ({"apart": 1e-3}, 1e-8),
        ({"apart": 1e-6}, 1e-8),
        ({"apart": 1e-6, "bodies": True}, 1e-11),
        param({"r": None, "s": None, "passive": 3}, 1e-9, marks=mark.slow),
        ({"r": None, "s": 3, "endless": 2}, 1e-9),
        param({"r": None, "s": None, "passive": 3, "weak": 0.05}, 1e-8, marks=mark.slow),
        ({"r": None, "s": None, "endless": 5}, 1e-9),
    ],
)
def test_the_optimum_in_exact_fractions(how, tolerance):
    """Stationary, feasible, with multipliers of the right sign; short only where it must be."""
    rng = default_rng(64)
    seen = 0
    for _ in range(6):
        case = random_case(rng, 5, **{"r": 2, "s": 1} | how)
        if how.get("apart") and "bodies" not in how:
            case = replace(case, Phi_e=np.zeros((2, 2)))  # its rounding errors count as yielding
        seen += agree(case, tolerance)
    assert seen < 6 and (seen > 1 or "weak" not in how)


def test_a_force_that_no_motor_reaches_and_motors_that_do_nothing():
    case = two_forces(67)
    for G in (0.0 * case.G, case.G * (np.arange(8) > 3)[:, None]):
        agree_within(replace(case, G=G, E=0.0 * case.E))
    out_of_reach = replace(
        case,
        Lambda=np.eye(6),
        N=np.eye(6)[:2],
        pushed=np.eye(6)[:2],
        Phi_e=np.zeros((2, 2)),
        G=case.G * (np.arange(6) != 1),
    )
    _, _, force, *_ = agree_within(out_of_reach)
    assert force[1] == 0.0 and np.isfinite(MADE[8].A[:16]).all()


def test_a_floor_above_the_command_is_the_command():
    case = two_forces(72)
    low = replace(case, alpha=case.alpha / 100.0)
    for got, expected in aligned(solve(low), solve(replace(low, floor=low.share @ low.alpha))):
        assert_array_equal(got, expected)


def test_a_floor_that_another_implies_changes_nothing(monkeypatch):
    """Even if the solver calls both of them active."""
    solver = daqp.solve
    active = []

    def both(*args, **how):
        z, value, verdict, info = solver(*args, **how)
        info["lam"][-1] = info["lam"][-2]
        active.append(info["lam"][-1] != 0.0)
        return (z + 1e-9, value, verdict, info)  # to be seen, if it is not worked out once more

    rng = default_rng(73)
    for _ in range(40):
        case = random_case(rng, d=5, r=2, k=2, s=1)
        twice = replace(case, share=case.share[[0, 1, 1]], floor=case.floor[[0, 1, 1]])
        expected, *_, short = solve(case)
        with monkeypatch.context() as patch:
            patch.setattr(daqp, "solve", both)
            got, *_, also = solve(twice)
        assert also == short and (short or largest((got - expected) / case.scale) < 1e-11)
    assert sum(active) > 10


def agree_within(case):
    tau, *rest = solve(case)
    assert within(tau, case.tau_max) and all(np.isfinite(x).all() for x in rest)
    return (tau, *rest)


@parametrize("verdict", [-1, 1])
def test_what_is_not_solved_is_an_error(monkeypatch, verdict):
    case = two_forces(69, weak=0.05)
    solve(two_forces(69))
    with raises(osc.SolverError, match="motor limits"):
        MADE[8].Lambda[:] = -np.eye(6)
        MADE[8].solve()

    def fail(H, f, *a, **k):
        return (np.full(len(f), np.nan), 0.0, verdict, {"lam": np.zeros(len(a[1]))})

    monkeypatch.setattr(daqp, "solve", fail)
    with raises(osc.SolverError, match="motor limits"):
        solve(replace(case, share=case.share[:0], floor=case.floor[:0]))


def test_nothing_accumulates():
    solve(two_forces(70))
    for _ in range(2):
        before = sys.getallocatedblocks()
        for _ in range(2000):
            MADE[8].solve()
        after = sys.getallocatedblocks()
    assert abs(after - before) < 20
