"""The virtual linkage of the law: against singular values and a full system of equations."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
from grasp_rigs import KINDS, random_case
from law_calls import bars
from numpy.random import default_rng
from numpy.testing import assert_allclose
from pytest import mark
from rigs import largest
from test_grasps import in_millimetres
from test_linkage import settable_bars as by_svd

import osc_contact as osc
from osc_contact.dynamics.arm import effort_scale
from osc_contact.law.records import Rows, new_model, views


def given(state, chain):
    """What `settable_bars` is given of a chain in a state."""
    k = len(chain.arms)
    n = chain.nq
    d = state.d
    G = np.zeros((n, d))
    effort = np.zeros(n)
    G[chain.actuated] = state.G.T
    effort[chain.actuated] = effort_scale(chain.tau_max)
    first, end = np.array([(s.start, s.stop) for s in chain.slices]).T.copy()
    force_levers = np.vstack([arm.J_bar[:, :3] for arm in state.arms])
    locked = np.hstack([arm.C[:3] for arm in state.arms]).T / np.sqrt(chain.reference.inertia.mass)
    owners = np.repeat(np.arange(k), [arm.C.shape[1] for arm in state.arms])
    return (
        k,
        n,
        state.grasp_points,
        first,
        end,
        force_levers,
        G,
        effort,
        locked.copy(),
        owners,
        len(owners),
        chain.angle_tolerance,
    )


def placed(what):
    """What is given in the records of a tick, and NaN where answers and scratch stand."""
    k, n, points, first, end, force_levers, G, effort, locked, owners, n_locked, tolerance = what
    rows = Rows(new_model(k, n, 0))
    model, _, work, _ = views(rows)
    model.angle_tolerance = tolerance
    model.arms.first = first
    model.arms.end = end
    work.points[:] = points
    work.force_levers[:] = force_levers
    work.efforts[:] = effort
    work.driven[:, : G.shape[1]] = G
    work.carried[:n_locked] = locked
    work.owners[:n_locked] = owners
    for out in (work.levers, work.basis, work.scratch):
        out[:] = np.nan
    return rows, n_locked


def answer(what):
    """(levers, basis (bars, s))."""
    rows, n_locked = placed(what)
    t = views(rows)
    s = bars.settable_bars(t, n_locked)
    work = t.work
    levers = work.levers
    basis = work.basis
    count = len(work.levers)
    assert_allclose(basis[:, :s].T @ basis[:, :s], np.eye(s), atol=1e-12)
    assert s < count or (basis == np.eye(count)).all()
    return levers, basis[:, :s]


def assert_same(got, want, levers_to=1e-10, basis_to=1e-9):
    """The same levers, and bases that span the same."""
    size = largest(want[0])
    assert_allclose(got[0], want[0], rtol=0, atol=levers_to * size)
    assert got[1].shape == want[1].shape
    assert_allclose(got[1] @ got[1].T, want[1] @ want[1].T, rtol=0, atol=basis_to)


def at_rest(case):
    return case.chain.state(case.q, np.zeros(case.chain.nq), case.X_WO, np.zeros(6))


def without_motors(case, rng, share):
    """A share of the joints of one arm lose theirs."""
    arms = list(case.chain.arms)
    i = int(rng.integers(len(arms)))
    names = list(arms[i].model.names)[1:]
    limp = tuple(name for name in names if name in arms[i].passive_joints or rng.random() < share)
    arms[i] = replace(arms[i], passive_joints=limp)
    parts = (arms, case.chain.grasps, case.chain.payload)
    return replace(case, chain=osc.ClosedChain(*parts, allow_unactuated=True))


def moved_points(points, how, rng):
    """Grasp points in a plane or nearly so, in a line, two in one place."""
    points = points.copy()
    if how == "plane":
        size = rng.choice([0.0, 10 ** rng.uniform(-5, -1)])
        points[:, 2] = points[0, 2] + size * rng.uniform(-1, 1, len(points))
    elif how == "line":
        points = points[0] + np.outer(rng.uniform(-1, 1, len(points)), rng.standard_normal(3))
    elif how == "same":
        points[1] = points[0]
    return points


def draw(how, rng):
    """A random chain of three to five arms, and its state."""
    k = int(rng.integers(3, 6))
    bends = None
    if how == "near singular":
        bends = rng.uniform(0.5, 1.5, k)
        bends[rng.integers(k)] = 10 ** rng.uniform(-6, -1)
    pool = ["scara", "2R", "3R"] if how == "structure" else ["ur5", "panda", "scara"]
    kinds = {"grasps": KINDS, "motors": KINDS[:3], "slides": KINDS[3:], "strong": KINDS[3:]}
    arms = rng.choice(pool, k)
    kinds = rng.choice(kinds.get(how, ["rigid"]), k)
    case = random_case(list(arms), list(kinds), rng, bends, upright=how == "structure")
    case = without_motors(case, rng, rng.choice([0.5, 1.0])) if how == "motors" else case
    if how == "strong":
        case.chain.tau_max[: case.chain.arms[0].model.nv - 1] *= 1e4
    state = at_rest(case)
    return case, replace(state, grasp_points=moved_points(state.grasp_points, how, rng))


@mark.parametrize(
    "how, least, most",
    [
        ("rigid", 0, 0),
        ("grasps", 1, 24),
        ("slides", 10, 24),
        ("structure", 20, 25),
        ("near singular", 2, 24),
        ("motors", 5, 24),
        ("plane", 10, 24),
        ("line", 25, 25),
        ("same", 10, 25),
        ("strong", 10, 25),
    ],
)
def test_it_decides_as_singular_values_do(how, least, most):
    rng = default_rng(80)
    fewer = 0
    for _ in range(25):
        case, state = draw(how, rng)
        got = answer(given(state, case.chain))
        assert_same(got, by_svd(state, case.chain))
        k = len(case.chain.arms)
        fewer += got[1].shape[1] < min(k * (k - 1) // 2, 3 * k - 6)
    assert least <= fewer <= most


def test_eight_arms_of_seven_joints():
    rng = default_rng(81)
    for kinds in (["rigid"] * 8, ["rigid", *["cylinder"] * 7]):
        case = random_case(["panda"] * 8, kinds, rng)
        state = at_rest(case)
        levers, basis = answer(given(state, case.chain))
        assert_same((levers, basis), by_svd(state, case.chain))
        assert len(levers) == 28 and (basis.shape[1] == 18) == (kinds[1] == "rigid")


def elsewhere(case, X):
    """The same chain at another place in the world."""
    arms = [replace(arm, base=X * arm.base) for arm in case.chain.arms]
    chain = osc.ClosedChain(arms, case.chain.grasps, case.chain.payload, allow_unactuated=True)
    return replace(case, chain=chain, X_WO=X * case.X_WO)


@mark.parametrize("how", ["rigid", "grasps", "slides", "structure", "near singular"])
def test_world_units_and_names_of_motions_do_not_matter(how):
    """Also the basis of the object's motions that G is written in."""
    rng = default_rng(83)
    for _ in range(8):
        case, state = draw(how, rng)
        what = given(state, case.chain)
        want = answer(what)
        X = pin.SE3(pin.exp3(rng.standard_normal(3)), rng.uniform(-2, 2, 3))
        other = elsewhere(case, X)
        assert_same(answer(given(at_rest(other), other.chain)), want, basis_to=1e-8)
        mixed = list(what)
        mixed[6] = what[6] @ (np.eye(state.d) + 0.3 * rng.standard_normal((state.d, state.d)))
        assert_same(answer(tuple(mixed)), want)
        chain, q, X_WO = in_millimetres(case)
        sliding = np.abs(q - case.q) > 0.0
        mm = list(given(chain.state(q, np.zeros(chain.nq), X_WO, np.zeros(6)), chain))
        mm[7] = np.where(sliding, 1e3, 1e6) * what[7]  # kg mm/s², kg mm²/s²
        levers, basis = answer(tuple(mm))
        per_torque = np.where(sliding, 1.0, 1e3)
        assert_same((levers * per_torque, basis), want, basis_to=1e-8)
