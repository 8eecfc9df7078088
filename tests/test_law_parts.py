"""Small functions of the law, each against linear algebra or Pinocchio: geometry and algebra.

Fast without compilation, so that these judge small faults put into the law (`tests/mutants.py`)
first. Arrays are larger than what counts and hold numbers beside it, as the law's scratch does.
`test_law_stages.py` continues with forces, stops and the stages of a tick.
"""

from itertools import product
from types import SimpleNamespace as Record

import numpy as np
import pinocchio as pin
from law_calls import algebra, commands, grasps, normals, operational, records, write
from law_calls import columns as columns_of_N
from numpy.linalg import norm, qr
from numpy.testing import assert_array_equal
from pytest import approx
from rigs import any_rotation, assert_near, largest, pose_of, unit
from samples import parametrize

from osc_contact.law import records as at

SEEDS = parametrize("seed", range(6))


def rng_of(seed):
    return np.random.default_rng(1000 + seed)


# --- rows of six, dense algebra -------------------------------------------------------------------


def test_what_cannot_be_factored_is_reported():
    """Rows of zeros, elements that no definite matrix has, pivots of next to nothing.

    The factors themselves judge `test_law_kkt`, `test_law_limits` and `test_linkage`.
    """
    rng = rng_of(0)
    for n in range(1, 8):
        root = rng.standard_normal((n, n))
        A = root @ root.T + 0.1 * np.eye(n)
        L, X, Q, B = rng.standard_normal((4, 8, 8))
        read = np.where(np.tri(n), A, np.nan)  # the lower triangle alone
        assert algebra.cholesky(read, 0, n, L) > 0.0
        broken = [np.diag([0.0] + [0.5] * (n - 2) + [-0.1]) + 1.0] if n > 1 else []
        for k, bad in product(range(n), (0.0, -1.0, np.nan)):
            broken.append(A.copy())
            broken[-1][k, k] = bad
        assert not any(algebra.cholesky(one, 0, n, L) for one in broken)  # the first: all above 0
        for k, share in product(range(n), (0.0, 0.5e-10, np.nan, 2e-10)):
            D = np.diag(-3.0 * np.ones(n))
            D[k, k] = 3.0 * share
            done = algebra.lu_solve(D, n, B, 1)
            assert done == (share == 2e-10 or (share == 0.5e-10 and k == 0))  # nothing is beside it
        X[n - 1] = 0.0
        assert not algebra.qr_rows(X.copy(), n, 8, np.zeros(8), np.zeros(8))
        assert algebra.orthonormalise(X[:, :6].copy(), n, 0, Q[:, :6].copy(), L) == 0.0


@SEEDS
def test_equations_with_a_triangular_matrix(seed):
    """R by `qr_rows`, one below the other; arrays of just the size, too."""
    rng = rng_of(seed)
    n = seed + 3
    X, Z = rng.standard_normal((2, 8, 8))
    diagonal = rng.uniform(1.0, 2.0, 8)
    R = np.triu(X[:n, :n].T, 1) + np.diag(diagonal[:n])
    expected = Z.copy()
    expected[:n, :2] = np.linalg.solve(R, Z[:n, :2])
    algebra.back_substitute(X, n, 2, diagonal, Z)
    assert_near(Z, expected, atol=1e-12)


@parametrize("columns", [1, 3, 6])
def test_columns_of_joints_are_factorised_unless_one_depends_on_those_before(columns):
    A = rng_of(8).standard_normal((7, 6))
    Q, L = np.full((7, 6), np.nan), np.full((columns, columns), np.nan)
    assert operational._qr_tall(A.copy(), 7, columns, Q, L)
    L = np.tril(L)
    np.fill_diagonal(L, 1.0 / np.diag(L))
    assert_near(Q[:, :columns] @ L.T, A[:, :columns], atol=1e-13)
    assert_near(Q[:, :columns].T @ Q[:, :columns], np.eye(columns), atol=1e-13)
    for zero in range(columns):
        broken = A.copy()
        broken[:, zero] = 0.0
        assert not operational._qr_tall(broken, 7, columns, Q, L)


def test_rows_that_nearly_depend_are_orthonormal_to_the_last_digit():
    X, Q, L = rng_of(1).standard_normal((3, 6, 6))
    X[3] = X[0] + 1e-7 * X[3]
    least = algebra.orthonormalise(X, 4, 2, Q, L)
    assert_near(Q[:4] @ Q[:4].T, np.eye(4), atol=1e-13)
    np.fill_diagonal(L, 1.0 / np.diag(L))
    assert_near(np.tril(L)[:4, :4] @ Q[:4, 2:], X[:4, 2:], atol=1e-13)
    assert_near(least, L[3, 3] / norm(X[3, 2:]), rtol=1e-9)


@parametrize("size", [1e-70, 1e-77, 1e-78, 1e-79, 1e-80, 1e-81, 1e-150, 1e-300])
def test_rows_of_next_to_nothing_turn_what_they_carry_without_stretching_it(size):
    """Squares of their products have few digits, or none. More rows than directions get there."""
    X = rng_of(7).standard_normal((5, 8)) * size
    X[:, 3:] = np.eye(5)
    algebra.one_sided_jacobi(X, 5, 3, 5)
    assert_near(X[:, 3:] @ X[:, 3:].T, np.eye(5), atol=1e-14)


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
            assert_near(found, angle * w, atol=1e-9 if angle > 2.9 else 1e-14, rtol=1e-6)


def test_exactly_half_a_turn_leaves_the_sign_open_but_not_the_axis():
    """Nothing is left of R − Rᵀ there that would tell one sign for each number of the axis."""
    for signs in SIGNS:
        w = np.array(signs) / norm(signs)
        found = np.array(commands.rotation_vector(2.0 * np.outer(w, w) - np.eye(3)))
        assert_near(np.pi * w, found * np.sign(found @ w), atol=1e-9)
    found = commands.rotation_vector(np.diag([1.0, -1.0 - 1e-9, -1.0 - 1e-9]))  # rounded
    assert_near(np.abs(found), [np.pi, 0.0, 0.0], atol=1e-8)


@SEEDS
def test_a_rotation_is_continued_and_squared_up(seed):
    rng = rng_of(seed)
    for angle in (0.0, 1e-9, 0.9e-6, 1.1e-6, 1e-3, 0.5, 2.0, 3.1):
        X = rng.standard_normal((4, 4))
        w = rng.standard_normal(3)
        w *= angle / norm(w)
        Y = X.copy()
        grasps.rotate(Y, w)
        assert_near(Y[:3, :3], pin.exp3(w) @ X[:3, :3], atol=1e-11)
        Y[:3, :3] = X[:3, :3]
        assert_array_equal(Y, X)
    X = np.ones((4, 4))
    X[:3, :3] = any_rotation(rng) + 0.05 * rng.standard_normal((3, 3))
    Q, R = qr(X[:3, :2])
    Q *= np.sign(np.diag(R))
    grasps._square_up(X)
    assert_near(X[:3, :2], Q, atol=1e-12)
    assert_near(X[:3, 2], np.cross(Q[:, 0], Q[:, 1]), atol=1e-12)
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
        assert_near(grasps._log_displacement(p, M.rotation), pin.log6(M).vector, atol=1e-9)
        twist = np.append(rng.standard_normal(3), w)
        M = pose_of(rng)
        R = np.full((6, 6), 7.0)
        point = np.append(M.translation, 7.0)
        R[:3, :3] = M.rotation
        grasps._displace(R, point, -twist)
        expected = M * pin.exp6(-twist)
        assert_near(R[:3, :3], expected.rotation, atol=1e-9)
        assert_near(point[:3], expected.translation, atol=1e-9)
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
        grasps._miss_of_group(arm, frame, X.homogeneous, out)
        assert_near(out[: len(N)], n, atol=1e-9)


@SEEDS
def test_hinges_and_balls_miss_by_a_way_and_a_turn(seed):
    rng = rng_of(seed)
    tip = pose_of(rng)
    X = pose_of(rng)
    point = rng.standard_normal(3)
    axis = any_rotation(rng)[0]
    tip_axis = any_rotation(rng)[0]
    if seed == 5:  # fits
        axis = X.rotation.T @ tip.rotation @ tip_axis
    rows = np.zeros((6, 6))
    rows[3:, 3:] = qr(np.column_stack((tip_axis, rng.standard_normal((3, 2)))))[0].T[[1, 2, 0]]
    arm = Record(point=point, axis=axis, tip_axis=tip_axis, grasp=rows, kind=at.HINGE)
    frame = np.vstack((tip.rotation, tip.translation))
    grasps._grasp_miss(arm, frame, X.homogeneous, out := np.full(6, 7.0))
    between = pin.Quaternion.FromTwoVectors(tip_axis, tip.rotation.T @ X.rotation @ axis)
    assert_near(out[:3], tip.actInv(X.act(point)), atol=1e-12)
    assert_near(out[3:5], rows[3:5, 3:] @ pin.log3(between.toRotationMatrix()), atol=1e-9)
    arm.kind = at.BALL
    grasps._grasp_miss(arm, frame, X.homogeneous, ball := np.full(6, 7.0))
    assert_array_equal(ball, [*out[:3], 7.0, 7.0, 7.0])


# --- columns that depend on one another -----------------------------------------------------------


@parametrize("size", [1e-6, 1.0, 1e6])
def test_dependent_columns_must_agree_on_the_normal_acceleration(size):
    """Three columns, of which two are kept; extents differ, as units do."""
    rng = rng_of(0)
    for share in rng.standard_normal((20, 2)):
        n_gamma = size * rng.standard_normal(2)
        implied = share @ n_gamma
        summands = abs(implied) + np.abs(share * n_gamma).sum()
        t = records(columns=8)
        write(t.work, where=-1, reason_amount=0.0, count=3, rank=2, chosen=[4, 2, 7], kept=[4, 2])
        rows = t.work.columns
        rows.extent = 1.0
        rows.n_gamma[[4, 2, 7]] = (*n_gamma, implied)
        rows.share[[4, 2, 7], :2] = (*np.eye(2), share)
        assert columns_of_N._n_gamma_is_consistent(t)
        most = max(summands, 2.0 * largest(n_gamma))
        for off, fine in {0.5e-5: True, -0.5e-5: True, 2e-5: False, -2e-5: False}.items():
            rows[7].n_gamma = implied + off * most
            if abs(off * most) > 2e-9 or fine:  # what is next to nothing may differ
                assert columns_of_N._n_gamma_is_consistent(t) == fine
        if size == 1.0:
            assert (t.work.where, t.work.reason_amount) == (7, approx(implied))


@parametrize("i", [0, 4, 8])
def test_what_is_learned_of_a_normal_that_turns_about_one_axis_is_kept(i):
    """Edges turn along one axis; only a zero covariance starts from the prior."""
    t = records(contacts=1, columns=1)
    last = t.memory.columns[0]
    t.work.columns[0].prior[:] = 1e-4
    last.covariance[i] = 1e-6
    normals.learn_normal(0.0, last, t.work.columns[0])
    assert last.normal_std == approx(1e-3)
