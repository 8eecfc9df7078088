"""Equations 3 to 12 against their definitions: decompositions, least constraint, invariance.

No test inverts NᵀΦN. A component of a vector is found by solving the 6×6 system of eqs. 1 and 2,
whose unknowns are the magnitudes in both complementary spaces, or by least squares.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from complaints import contact_error
from numpy.linalg import inv, matrix_rank, qr, solve
from numpy.random import default_rng
from rigs import largest
from samples import parametrize

from osc_contact import projections as P

RANKS = range(7)
TRIALS = range(2)
#: rad/s, kg m², N m and m/s, kg, N: what a hand-held object in SI units looks like
SIZE = np.array([1.0, 1.0, 1.0, 0.2, 0.2, 0.2])


@dataclass(frozen=True)
class Case:
    """A contact with two metrics of each kind; N and T from one orthogonal matrix, then mixed."""

    N: np.ndarray
    T: np.ndarray
    A: tuple[np.ndarray, np.ndarray]
    B: tuple[np.ndarray, np.ndarray]


def definite(rng, size):
    """A random positive definite matrix whose elements have the magnitudes size·sizeᵀ."""
    X = rng.standard_normal((6, 6))
    return (X @ X.T + 0.3 * np.eye(6)) * np.outer(size, size)


def mixing(rng, n):
    """A well-conditioned change of basis."""
    return rng.standard_normal((n, n)) + 3.0 * np.eye(n)


def case(seed, r):
    rng = default_rng([seed, r])
    Q = qr(rng.standard_normal((6, 6)))[0]
    return Case(
        N=SIZE[:, None] * (Q[:, :r] @ mixing(rng, r)),
        T=(Q[:, r:] @ mixing(rng, 6 - r)) / SIZE[:, None],
        A=(definite(rng, SIZE), definite(rng, SIZE)),
        B=(definite(rng, 1 / SIZE), definite(rng, 1 / SIZE)),
    )


def inverse(A):
    inverted = inv(A)
    return 0.5 * (inverted + inverted.T)


def part(first, second, x):
    """The component of x in range(first) when the rest lies in range(second): eqs. 1 and 2."""
    magnitudes = solve(np.hstack((first, second)), x)
    return first @ magnitudes[: first.shape[1]]


def close(got, want, tolerance=1e-10):
    """Equal relative to the larger of the two, linear and angular rows each on their own scale."""
    assert got.shape == want.shape
    for rows in (slice(0, 3), slice(3, 6)):
        scale = max(largest(want[rows]), largest(got[rows]), 1e-3)
        assert largest(got[rows] - want[rows]) <= tolerance * scale


def on_every_contact(test):
    return parametrize("r", RANKS)(parametrize("seed", TRIALS)(test))


@on_every_contact
def test_every_projection_is_the_decomposition_it_stands_for(seed, r):
    """On a basis, so that ranges, kernels, Ω² = Ω and Ω + Ω̄ = 1 are those of the decomposition."""
    c = case(seed, r)
    A = c.A[0]
    B = c.B[0]
    forces = np.diag(SIZE)
    motions = np.diag(1 / SIZE)
    close(P.Omega_f(c.N, inverse(A)) @ forces, part(c.N, A @ c.T, forces))
    close(P.Omega_f_bar(c.T, A) @ forces, part(A @ c.T, c.N, forces))
    close(P.Omega_m(c.T, inverse(B)) @ motions, part(c.T, B @ c.N, motions))
    close(P.Omega_m_bar(c.N, B) @ motions, part(B @ c.N, c.T, motions))


@on_every_contact
def test_identities_9_to_12(seed, r):
    """With the bars that eqs. 10 and 12 lost; as printed they hold only where a space is empty."""
    c = case(seed, r)
    f1, f2 = (P.Omega_f(c.N, inverse(A)) for A in c.A)
    g1, g2 = (P.Omega_f_bar(c.T, A) for A in c.A)
    m1, m2 = (P.Omega_m(c.T, inverse(B)) for B in c.B)
    w1, w2 = (P.Omega_m_bar(c.N, B) for B in c.B)
    for one, other in ((f1, f2), (m1, m2)):
        close(one @ other, other)
        assert not 0 < r < 6 or largest(one - other) > 1e-6
    for one, other, none in ((g1, g2, f2), (w1, w2, m2)):
        close(one @ other, one)
        assert (np.abs(one @ none) <= 1e-10 * (np.abs(one) @ np.abs(none))).all()
        assert not 0 < r < 6 or largest(one @ other) > 1e-3


@parametrize("r", [1, 2, 3, 4, 5])
@parametrize("seed", TRIALS)
def test_rank_five_inverse_inertia_is_enough(seed, r):
    """Dual SCARA: Φ has rank 5, Λ does not exist; the laws are the limit of definite metrics."""
    c = case(seed, r)
    rng = default_rng([seed, r, 4])
    root = rng.standard_normal((6, 5)) / SIZE[:, None]
    Phi = root @ root.T
    assert matrix_rank(Phi) == 5
    f = SIZE * rng.standard_normal(6)
    alpha = np.linalg.lstsq(root.T @ c.N, root.T @ f, rcond=None)[0]
    projection = P.Omega_f(c.N, Phi)
    close(projection @ f, c.N @ alpha, 1e-8)
    close(projection @ projection, projection, 1e-8)
    close(projection @ c.N, c.N, 1e-8)
    close(P.Omega_m_bar(c.N, Phi), projection.T, 1e-8)
    # the limit: full-rank metrics closer and closer to Φ, extrapolated
    extra = definite(rng, 1 / SIZE)
    one, two = (P.Omega_f(c.N, Phi + e * extra) for e in (1e-7, 2e-7))
    close(2 * one - two, projection, 1e-5)


@parametrize("i", range(6))
def test_metrics_that_hardly_move_along_one_axis_are_refused_there(i):
    """Beside the others of its kind: a metric of angles alone may be as small as it likes."""
    metric = np.eye(6)
    metric[i, i] = 1e-14
    with contact_error("column 0"):
        P.Omega_f(np.eye(6)[:, [i]], metric)
    kind = np.where(np.arange(6) // 3 == i // 3, 1e-14, 1.0)
    close(P.Omega_f(np.eye(6)[:, [i]], np.diag(kind)), np.diag(np.eye(6)[i]))


@parametrize("size", [1e-6, 0.5, 2.0])
def test_metrics_that_are_not_symmetric_or_not_definite_are_refused(size):
    """A millionth is no rounding error. Along N or not."""
    N = np.eye(6)[:, :2]
    skew = np.eye(6)
    skew[1, 0] = size
    with contact_error(f"not symmetric \\(relative difference {size:.3g}"):
        P.Omega_f(N, skew)
    mixed = np.eye(6)
    mixed[0, 1] = mixed[1, 0] = 1.0 + size  # positive diagonal, negative eigenvalue
    for sunken in (*(np.diag(np.where(np.arange(6) == i, -size, 1.0)) for i in (1, 5)), mixed):
        with contact_error(f"smallest eigenvalue -{size:.3g}"):
            P.Omega_f(N, sunken)
    for within in (1e-12, -1e-12):  # is one
        skew[1, 0] = within
        close(P.Omega_f(N, skew), P.Omega_f(N, np.eye(6)))


@parametrize("k", [2, 3, 4, 5, 6])
def test_zero_columns_are_refused(k):
    rng = default_rng(k)
    columns = SIZE[:, None] * rng.standard_normal((6, k))
    columns[:, -1] = 0.0
    for law in (P.Omega_f, P.Omega_f_bar, P.Omega_m, P.Omega_m_bar):
        with contact_error(f"column {k - 1}"):
            law(columns, definite(rng, 1 / SIZE))


@on_every_contact
def test_any_complement_decomposes(seed, r):
    """Eqs. 3 and 4 with complements that no definite matrix need have made, of any size.

    One vector in common with the other space is enough to be none.
    """
    c = case(seed, r)
    rng = default_rng([seed, r, 1])
    N_prime = SIZE[:, None] * rng.standard_normal((6, 6 - r))
    T_prime = rng.standard_normal((6, r)) / SIZE[:, None]
    f = SIZE * rng.standard_normal(6)
    v = rng.standard_normal(6) / SIZE
    for unit in (1e-7, 1.0, 1e7):
        got = P.Omega_f_bar_from_complement(unit * N_prime, unit * c.T) @ f
        close(got, part(N_prime, c.N, f), 1e-9)
    close(P.Omega_m_bar_from_complement(T_prime, c.N) @ v, part(T_prime, c.T, v), 1e-9)
    if r in (0, 6):
        return
    N_prime[:, 0] = c.N @ rng.standard_normal(r)
    T_prime[:, 0] = c.T @ rng.standard_normal(6 - r)
    for unit in (1e-7, 1.0, 1e7):
        with contact_error("N′ is not a complement of N"):
            P.Omega_f_bar_from_complement(unit * N_prime @ mixing(rng, 6 - r), unit * c.T)
    with contact_error("T′ is not a complement of T"):
        P.Omega_m_bar_from_complement(T_prime @ mixing(rng, r), c.N)
    with contact_error("complement"):
        P.Omega_m_bar_from_complement(np.zeros((6, r)), c.N)


# Invariance ---------------------------------------------------------------------------------------


def well_mixing(rng, n):
    """A change of basis that costs hardly any digits: columns turned, then scaled."""
    return qr(rng.standard_normal((n, n)))[0] * 10 ** rng.uniform(-2, 2, n)


def frame_change(rng):
    """Turned axes and another operational point, up to 2 m away: motions by X, forces by X*."""
    X = pin.SE3(pin.exp3(2.0 * rng.standard_normal(3)), rng.uniform(-2.0, 2.0, size=3))
    return X.toActionMatrix(), X.toDualActionMatrix()


def millimetres(_):
    """m → mm with N kept: velocities × 1000, couples × 1000 (N mm); power then counts in N mm/s."""
    return np.diag([1e3] * 3 + [1.0] * 3), np.diag([1.0] * 3 + [1e3] * 3)


def millimetres_and_grams(_):
    """m → mm and kg → g: forces × 10⁶ (g mm/s²), couples × 10⁹."""
    return np.diag([1e3] * 3 + [1.0] * 3), np.diag([1e6] * 3 + [1e9] * 3)


def check_change(c, X, X_f, R, Q):
    """Every law in new coordinates is the old law, mapped. R, Q: new bases of N and T.

    Forces map with X_f, motions with X; A: M⁶ → F⁶ maps as X_f A X⁻¹, B: F⁶ → M⁶ as X B X_f⁻¹.
    """
    N = X_f @ c.N @ R
    T = X @ c.T @ Q
    A = c.A[0]
    B = c.B[0]
    A_new = X_f @ A @ inv(X)
    B_new = X @ B @ inv(X_f)
    A_inv = X @ inverse(A) @ inv(X_f)
    B_inv = X_f @ inverse(B) @ inv(X)
    f, v = default_rng(0).standard_normal((2, 6)) * (SIZE, 1 / SIZE)
    of_f = P.Omega_f_bar_from_complement
    of_m = P.Omega_m_bar_from_complement
    for new, old, law, x in (
        (P.Omega_f(N, A_inv), P.Omega_f(c.N, inverse(A)), X_f, f),
        (P.Omega_f_bar(T, A_new), P.Omega_f_bar(c.T, A), X_f, f),
        (P.Omega_m(T, B_inv), P.Omega_m(c.T, inverse(B)), X, v),
        (P.Omega_m_bar(N, B_new), P.Omega_m_bar(c.N, B), X, v),
        (of_f(X_f @ A @ c.T, T), of_f(A @ c.T, c.T), X_f, f),
        (of_m(X @ B @ c.N, N), of_m(B @ c.N, c.N), X, v),
    ):
        close(solve(law, new @ law @ x), old @ x, 1e-9)


@parametrize("change", [frame_change, millimetres, millimetres_and_grams])
@parametrize("trial", range(21))
def test_laws_do_not_depend_on_frame_units_or_basis(trial, change):
    rng = default_rng([trial, 7])
    r = trial % 7
    assert callable(change)
    X, X_f = change(rng)
    check_change(case(trial, r), X, X_f, np.eye(r), np.eye(6 - r))
    check_change(case(trial, r), X, X_f, well_mixing(rng, r), well_mixing(rng, 6 - r))


# Null space ---------------------------------------------------------------------------------------


def test_null_space_of_pure_forces_and_pure_couples():
    for columns in (np.eye(6)[:, :2], np.eye(6)[:, 3:], 1e-6 * np.eye(6)[:, 5:]):
        T = P.null_space(columns)
        assert largest(columns.T @ T) <= 1e-15
        assert matrix_rank(np.hstack((columns / largest(columns), T))) == 6
