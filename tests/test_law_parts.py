"""Small functions of the law, each against linear algebra or Pinocchio: geometry and algebra.

Fast without compilation, so that these judge small faults put into the law (`tests/mutants.py`)
first. Arrays are larger than what counts and hold numbers beside it, as the law's scratch does.
`test_law_stages.py` continues with forces, stops and the stages of a tick.
"""

from itertools import product
from types import SimpleNamespace as Record

import numpy as np
import pinocchio as pin
from law_calls import algebra, commands, contact, grasps, records, tick_of, vectors, write
from law_calls import columns as columns_of_N
from numpy.linalg import norm, qr
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from pytest import approx
from rigs import direction, largest, pose_of, sliding, unit
from samples import parametrize

from osc_contact import VertexOnFace
from osc_contact.interface import Touched
from osc_contact.law import records as at

SEEDS = parametrize("seed", range(6))
close = assert_allclose


def rng_of(seed):
    return default_rng(1000 + seed)


def turn(rng, angle=None):
    """A rotation, random or by an angle."""
    w = rng.standard_normal(3)
    return pin.exp3(w if angle is None else angle * w / norm(w))


def around(rng, A, before=0, behind=2):
    """A matrix among other numbers."""
    whole = rng.standard_normal(np.array(A.shape) + before + behind)
    whole[before : before + len(A), before : before + A.shape[1]] = A
    return whole


def inertia(rng, n):
    root = rng.standard_normal((n, n))
    return root @ root.T + 0.1 * np.eye(n)


# --- rows of six, dense algebra -------------------------------------------------------------------


def noise(rng, *shapes):
    """Arrays of numbers that count for nothing."""
    return [rng.standard_normal(shape) for shape in shapes]


def assert_qr(before, R, diagonal, Q):
    rows = before.shape[1]
    upper = np.triu(R[:rows, :rows], 1) + np.diag(diagonal[:rows])
    close(Q.T @ Q, np.eye(Q.shape[1]), atol=1e-12)
    close(Q[:, :rows] @ upper, before, atol=1e-12)
    return upper


@parametrize("rows", range(1, 7))
def test_qr_of_columns_of_six(rows):
    rng = rng_of(rows)
    X, R, Q, diagonal, beta = noise(rng, (8, 6), (8, 8), (7, 7), 8, 8)
    before = X[:rows].T.copy()
    assert vectors.qr6(X, rows, R, diagonal, beta)
    assert not np.tril(X[:rows, :rows], -1).any(), "reflectors begin with zeros"
    vectors.form_q6(X, rows, beta, Q)
    assert_qr(before, R, diagonal, Q[:6, :6].T)
    for k in range(rows):
        X = rng.standard_normal((8, 6))
        X[k] = 0.0
        assert not vectors.qr6(X, rows, R, diagonal, beta)


@parametrize(("rows", "length"), [(1, 1), (1, 6), (2, 3), (3, 7), (4, 4), (5, 7)])
def test_qr_of_rows_of_any_length(rows, length):
    rng = rng_of(rows + length)
    X, diagonal, beta = noise(rng, (length + 2, length + 2), length + 2, length + 2)
    before = X[:rows, :length].T.copy()
    assert algebra.qr_rows(X, rows, length, diagonal, beta)
    for count in (rows, length):
        (Q,) = noise(rng, (length + 1, length + 1))
        algebra.form_q(X, rows, length, beta, count, Q)
        R = assert_qr(before, X[:rows, :rows].T, diagonal, Q[:count, :length].T)
    (Z,) = noise(rng, (rows + 1, 5))
    rest = Z.copy()
    algebra.back_substitute(X, rows, 4, diagonal, Z)
    close(R @ Z[:rows, :4], rest[:rows, :4], atol=1e-9)
    Z[:rows, :4] = rest[:rows, :4]
    assert_array_equal(Z, rest)
    (X,) = noise(rng, (rows, length))
    X[rows - 1] = 0.0
    assert not algebra.qr_rows(X, rows, length, diagonal, beta)


@parametrize("n", range(1, 8))
@parametrize("first", [0, 2])
def test_cholesky_and_what_it_solves(n, first):
    rng = rng_of(n)
    A = inertia(rng, n)
    whole = around(rng, A, first)
    whole[np.triu_indices(len(whole), 1)] = np.nan
    L, x, b = noise(rng, (n + 1, n + 1), n + first + 2, n)
    least = algebra.cholesky(whole, first, n, L)
    want = np.linalg.cholesky(A)
    close(np.tril(L[:n, :n], -1), np.tril(want, -1), atol=1e-10)
    close(1.0 / np.diag(L)[:n], np.diag(want), rtol=1e-10)
    close(least, min(np.diag(want) ** 2 / np.diag(A)), rtol=1e-9)
    own = slice(first, first + n)
    x[own] = b
    y = x.copy()
    algebra.cholesky_solve(L, n, y, first)
    close(A @ y[own], b, atol=1e-9)
    y[own] = b
    assert_array_equal(y, x)
    definite = [np.diag([0.0] + [0.5] * (n - 2) + [-0.1]) + 1.0] if n > 1 else []
    for k, bad in product(range(n), (0.0, -1.0, np.nan)):
        definite.append(A.copy())
        definite[-1][k, k] = bad
    for broken in definite:  # the first one has positive elements
        assert algebra.cholesky(broken, 0, n, L) == 0.0


@SEEDS
def test_inverse_of_an_inertia(seed):
    rng = rng_of(seed)
    A = inertia(rng, 6)
    L, out = noise(rng, (6, 6), (6, 6))
    pivots = np.diag(np.linalg.cholesky(A)) ** 2
    close(algebra.invert_spd6(np.tril(A), L, out), min(pivots / np.diag(A)), rtol=1e-9)
    close(out, np.linalg.inv(A), atol=1e-8)
    A[seed, seed] = -1.0
    assert algebra.invert_spd6(A, L, out) == 0.0


@parametrize("n", range(1, 8))
def test_elimination_with_pivots(n):
    rng = rng_of(n)
    for columns in (0, 1, 3):
        A, B = noise(rng, (n, n), (n + columns, n + 1))
        A[0, 0] = 0.0 if n > 1 else -2.0
        B = B[: columns + 2]
        before = B.copy()
        assert algebra.lu_solve(around(rng, A) if n != 6 else A.copy(), n, B, columns)
        close(B[:columns, :n] @ A.T, before[:columns, :n], atol=1e-9)
        assert_array_equal(B[columns:], before[columns:])
    for k in range(n):
        for share in (0.0, 0.5e-10, np.nan, 2e-10):  # a pivot that is next to nothing
            A = np.diag(-3.0 * np.ones(n))
            A[k, k] = 3.0 * share
            (B,) = noise(rng, (1, n))
            b = B.copy()
            done = algebra.lu_solve(A.copy(), n, B, 1)
            assert done == (share == 2e-10 or (share == 0.5e-10 and k == 0))  # nothing is beside it
            if done:
                close(A @ B[0], b[0], rtol=1e-9)
        if n > 1:
            A, B = noise(rng, (n, n), (1, n))
            A[:, k] = A[:, k - 1]
            assert not algebra.lu_solve(A[rng.permutation(n)], n, B, 1)


@parametrize("kind", ["any", "alike", "zero", "sizes"])
@parametrize(("count", "length"), [(1, 3), (2, 2), (3, 7), (5, 6), (6, 6), (6, 3)])
def test_rows_rotated_until_they_are_orthogonal(count, length, kind):
    (X,) = noise(rng_of(count + length), (count + 1, length + count + 1))
    if kind == "alike":  # of one length, neither parallel nor orthogonal
        X[:count, :length] = 1.0
        X[range(min(count, length)), range(min(count, length))] = -1.0
    elif kind == "zero":
        X[0, :length] = 0.0
    elif kind == "sizes":
        X[:count] *= 10.0 ** -np.arange(count)[:, None]
    X[:count, length : length + count] = np.eye(count)
    before = X.copy()
    algebra.one_sided_jacobi(X, count, length, count)
    U = X[:count, length : length + count]
    rows = X[:count, :length]
    close(U @ U.T, np.eye(count), atol=1e-12)
    close(U @ before[:count, :length], rows, atol=1e-12)
    gram = rows @ rows.T
    size = np.sqrt(np.diag(gram))
    assert (abs(gram - np.diag(np.diag(gram))) <= 1e-12 * max(size) ** 2).all()
    want = np.linalg.svd(before[:count, :length], compute_uv=False)
    want = np.pad(want, (0, count - len(want)))
    close(np.sort(size)[::-1], want, atol=1e-12 * want[0])
    X[:count, : length + count] = before[:count, : length + count]
    assert_array_equal(X, before)


@parametrize("size", [1e-70, 1e-77, 1e-78, 1e-79, 1e-80, 1e-81, 1e-150, 1e-300])
def test_rows_of_next_to_nothing_turn_what_they_carry_without_stretching_it(size):
    """Squares of their products have few digits, or none. More rows than directions get there."""
    X = rng_of(7).standard_normal((5, 8)) * size
    X[:, 3:] = np.eye(5)
    algebra.one_sided_jacobi(X, 5, 3, 5)
    close(X[:, 3:] @ X[:, 3:].T, np.eye(5), atol=1e-14)


@parametrize(("m", "r"), [(0, 1), (0, 3), (0, 6), (2, 3), (2, 4), (5, 1)])
def test_lower_factor_and_orthonormal_rows(m, r):
    rng = rng_of(10 * m + r)
    for near in (1.0, 1e-7):
        X, Q, L = noise(rng, (7, 6), (7, 6), (7, 7))
        X[r - 1] = X[0] + near * X[r - 1]
        before = X.copy()
        least = algebra.orthonormalise(X, r, m, Q, L)
        assert_array_equal(X, before)
        Q = Q[:r].copy()
        L = L[:r, :r]
        assert not Q[:, :m].any()
        close(Q @ Q.T, np.eye(r), atol=1e-13)
        close(np.tril(L) @ Q[:, m:], X[:r, m:], atol=1e-13)
        close(least, min(np.diag(L) / norm(X[:r, m:], axis=1)), rtol=1e-9)
    X[r - 1, m:] = 0.0
    assert algebra.orthonormalise(X, r, m, np.zeros((7, 6)), np.zeros((7, 7))) == 0.0
    L, b, x, wanted = noise(rng, (r + 1, r + 1), r + 1, 6, r)
    A = np.tril(L[:r, :r])
    for solve, of in ((algebra.solve_lower, A), (algebra.solve_lower_transposed, A.T)):
        y = b.copy()
        solve(L, r, y)
        close(of @ y[:r], b[:r], atol=1e-9)
        assert y[r] == b[r]
    algebra.project_onto_constraint(Q, r, y := x.copy(), wanted)
    close(y, x + Q.T @ (wanted - Q @ x), atol=1e-12)


# --- rotations and poses --------------------------------------------------------------------------

SIGNS = [s for s in product((-1.0, 0.0, 1.0), repeat=3) if any(s)]


def test_rotation_vectors_of_all_angles_and_axes():
    rng = rng_of(0)
    angles = [0.0, 1e-12, 1e-7, 0.9e-6, 1.1e-6, 1e-3, 0.3, 1.0, 1.6, 2.5, 2.9, 2.999, 3.0, 3.001]
    angles += [3.1, np.pi - 1e-3, np.pi - 1e-6]
    for signs in SIGNS:
        w = unit(np.array(signs) * rng.uniform(0.2, 1.0, 3))
        for angle in angles:
            R = np.full((6, 6), 7.0)
            R[:3, :3] = pin.exp3(angle * w)
            found = commands.rotation_vector(R)
            close(found, angle * w, rtol=1e-6, atol=1e-9 if angle > 2.9 else 1e-14)


def test_exactly_half_a_turn_leaves_the_sign_open_but_not_the_axis():
    """Nothing is left of R − Rᵀ there that would tell one sign for each number of the axis."""
    for signs in SIGNS:
        w = np.array(signs) / norm(signs)
        found = np.array(commands.rotation_vector(2.0 * np.outer(w, w) - np.eye(3)))
        close(np.pi * w, found * np.sign(found @ w), atol=1e-9)
    found = commands.rotation_vector(np.diag([1.0, -1.0 - 1e-9, -1.0 - 1e-9]))  # rounded
    close(np.abs(found), [np.pi, 0.0, 0.0], atol=1e-8)


@SEEDS
def test_a_rotation_is_continued_and_squared_up(seed):
    rng = rng_of(seed)
    for angle in (0.0, 1e-9, 0.9e-6, 1.1e-6, 1e-3, 0.5, 2.0, 3.1):
        X = rng.standard_normal((4, 4))
        w = rng.standard_normal(3)
        w *= angle / norm(w)
        Y = X.copy()
        grasps.rotate(Y, w)
        close(Y[:3, :3], pin.exp3(w) @ X[:3, :3], atol=1e-11)
        Y[:3, :3] = X[:3, :3]
        assert_array_equal(Y, X)
    X = np.ones((4, 4))
    X[:3, :3] = turn(rng) + 0.05 * rng.standard_normal((3, 3))
    Q, R = qr(X[:3, :2])
    Q *= np.sign(np.diag(R))
    grasps._square_up(X)
    close(X[:3, :2], Q, atol=1e-12)
    close(X[:3, 2], np.cross(Q[:, 0], Q[:, 1]), atol=1e-12)
    assert_array_equal(X[3], 1.0)


@SEEDS
def test_logarithm_and_exponential_of_a_motion(seed):
    """Series below 10 mrad, and what they stand for above."""
    rng = rng_of(seed)
    for angle in (0.0, 1e-5, 0.0099, 0.0101, 0.1, 0.9, 2.0, 3.0):
        w = rng.standard_normal(3)
        p = rng.standard_normal(3)
        w *= angle / norm(w)
        M = pin.SE3(pin.exp3(w), p)
        close(grasps._remaining(p, M.rotation), pin.log6(M).vector, atol=1e-9)
        twist = np.concatenate((rng.standard_normal(3), w))
        M = pose_of(rng)
        R = np.full((6, 6), 7.0)
        point = np.append(M.translation, 7.0)
        R[:3, :3] = M.rotation
        grasps._take_off(R, point, -twist)
        want = M * pin.exp6(-twist)
        close(R[:3, :3], want.rotation, atol=1e-9)
        close(point[:3], want.translation, atol=1e-9)
        assert R[3, 3] == 7.0 == point[3]


GROUPS = {  # motions of a joint, their rows of T
    "cylinder": np.eye(6)[[2, 5]],
    "plane": np.eye(6)[[0, 1, 5]],
    "ball": np.eye(6)[[3, 4, 5]],
    "screw": np.array([[0.0, 0.0, 0.6, 0.0, 0.0, 0.8]]),
    "slides": np.eye(6)[[0, 2]],
}


@parametrize("name", GROUPS)
def test_the_permitted_part_of_a_miss_is_taken_off(name):
    """X = tip exp(n) exp(t) X_TO misses its grasp by n, however large the permitted t is."""
    rng = rng_of(0)
    T = GROUPS[name]
    N = np.eye(6)[[i for i in range(6) if not T[:, i].any()]]
    if name == "screw":
        N = np.vstack((N, [0.0, 0.0, 0.8, 0.0, 0.0, -0.6]))
    for size in (0.0, 1e-3, 0.3, 1.5):
        n = 0.2 * rng.standard_normal(len(N))
        t = size * rng.uniform(-1.0, 1.0, len(T))
        tip = pose_of(rng)
        X_TO = pose_of(rng)
        X = tip * pin.exp6(N.T @ n) * pin.exp6(T.T @ t) * X_TO
        arm = Record(
            m=len(N),
            grasp=np.vstack((N, T)),
            X_TO=np.append(X_TO.rotation.ravel(), X_TO.translation),
        )
        frame = np.vstack((tip.rotation, tip.translation))
        out = np.full(6, 7.0)
        grasps._miss_of_group(arm, frame, X.homogeneous, np.zeros((6, 6)), out * 0.0, out)
        close(out[: len(N)], n, atol=1e-9)


@SEEDS
def test_hinges_and_balls_miss_by_a_way_and_a_turn(seed):
    rng = rng_of(seed)
    tip = pose_of(rng)
    X = pose_of(rng)
    point = rng.standard_normal(3)
    axis = turn(rng)[0]
    tip_axis = turn(rng)[0]
    if seed == 5:  # fits
        axis = X.rotation.T @ tip.rotation @ tip_axis
    rows = np.zeros((6, 6))
    rows[3:, 3:] = qr(np.column_stack((tip_axis, rng.standard_normal((3, 2)))))[0].T[[1, 2, 0]]
    arm = Record(point=point, axis=axis, tip_axis=tip_axis, grasp=rows, kind=at.HINGE)
    frame = np.vstack((tip.rotation, tip.translation))
    grasps._miss(arm, frame, X.homogeneous, out := np.full(6, 7.0))
    between = pin.Quaternion.FromTwoVectors(tip_axis, tip.rotation.T @ X.rotation @ axis)
    close(out[:3], tip.actInv(X.act(point)), atol=1e-12)
    close(out[3:5], rows[3:5, 3:] @ pin.log3(between.toRotationMatrix()), atol=1e-9)
    arm.kind = at.BALL
    grasps._miss(arm, frame, X.homogeneous, ball := np.full(6, 7.0))
    assert_array_equal(ball, [*out[:3], 7.0, 7.0, 7.0])


# --- faces ----------------------------------------------------------------------------------------


@parametrize("moving", [False, True])
@parametrize("mu", [0.0, 0.3])
def test_friction_is_that_of_the_slip_two_periods_ahead(moving, mu):
    """A vertex on a face, on a body that moves or is the world."""
    rng = rng_of(3)
    X = pose_of(rng)
    E = pose_of(rng)
    V_O, V_W = rng.standard_normal((2, 6))
    pair = VertexOnFace(*rng.standard_normal((2, 3)), direction(rng))
    A_D = 30.0 * rng.standard_normal(6)
    dt = 1e-3
    slip = 0.01
    t = records(contacts=1, columns=1, reading=at.LEAST_SQUARES, period=dt, slip=slip)
    write(t.model.pairs[0], kind=at.POINTS, first=0, count=1, shape_at=0, has_friction=1)
    write(t.model.shapes[0], row=[*pair.vertex, *pair.normal, pair.normal @ pair.point])
    write(t.input, touched=[[*E.homogeneous.ravel(), *V_W]])
    write(t.work, A_D=A_D, mu=mu, X_WO=X.homogeneous, V_O=V_O, moving=moving)
    column = t.work.columns[0]
    assert contact.place_contacts(t)
    seen = [E.homogeneous], [V_W], [A_D]
    touched = Touched(*map(np.array, seen)) if moving else None
    ((p, _, s),) = sliding([pair], X, V_O + 2.0 * dt * A_D, touched, slip)
    close(column.point, p, atol=1e-10)
    close(column.slip, s, atol=1e-10)
    close(column.friction_wrench, mu * np.append(s, np.cross(p, s)), atol=1e-10)
    t.model.reading = at.FILTER
    column.slip[:] = 9.0
    contact.place_contacts(t)
    assert (column.slip[0] == 9.0) == (mu == 0.0), "not needed"


# --- columns that depend on one another -----------------------------------------------------------


@parametrize("size", [1e-6, 1.0, 1e6])
def test_dependent_columns_must_agree_on_the_normal_acceleration(size):
    """Three columns, of which two are kept; extents differ, as units do."""
    rng = rng_of(0)
    for share in rng.standard_normal((20, 2)):
        n_gamma = size * rng.standard_normal(2)
        implied = share @ n_gamma
        summands = abs(implied) + np.abs(share * n_gamma).sum()
        rows = [
            Record(n_gamma=n_gamma[0], share=[1.0, 0.0], extent=1.0, chosen=4),
            Record(n_gamma=n_gamma[1], share=[0.0, 1.0], extent=1.0, chosen=2),
            Record(n_gamma=implied, share=share, extent=1.0, chosen=7),
        ]
        work = Record(keep=[0.0, 1.0], where=-1, amount=0.0, count=3, rank=2)

        def check(rows, work):
            return columns_of_N._consistent(tick_of(work_columns=rows, work=work))

        assert check(rows, work)
        most = max(summands, 2.0 * largest(n_gamma))
        for off, fine in ((0.5e-5, True), (-0.5e-5, True), (2e-5, False), (-2e-5, False)):
            rows[2].n_gamma = implied + off * most
            if abs(off * most) > 2e-9 or fine:  # what is next to nothing may differ
                assert check(rows, work) == fine
        if size == 1.0:
            assert (work.where, work.amount) == (7, approx(implied))


@parametrize("i", [0, 4, 8])
def test_what_is_learned_of_a_normal_that_turns_about_one_axis_is_kept(i):
    """As at edges along an axis of their body; only a covariance of zeros begins with the prior."""
    t = records(contacts=1, columns=1)
    last = t.memory.columns[0]
    t.work.columns[0].prior[:] = 1e-4
    last.covariance[i] = 1e-6
    contact.learn_normal(0.0, last, t.work.columns[0])
    assert last.normal_std == approx(1e-3)
