"""Equations 3 to 12 against their definitions: decompositions, least constraint, invariance.

No test inverts NᵀΦN. A component of a vector is found by solving the 6×6 system of eqs. 1 and 2,
whose unknowns are the magnitudes in both complementary spaces, or by least squares.
"""

from types import SimpleNamespace

import numpy as np
from complaints import contact_error
from numpy.linalg import inv, lstsq, matrix_rank, qr, solve
from numpy.random import default_rng
from rigs import largest, vector
from samples import parametrize

from osc_contact import projections as P

#: rad/s, kg m², N m and m/s, kg, N: what a hand-held object in SI units looks like
SIZE = vector(1.0, 1.0, 1.0, 0.2, 0.2, 0.2)
#: of force: N, N m; N, N mm; g mm/s², g mm²/s²
UNITS = np.repeat([[1.0, 1.0], [1.0, 1e3], [1e6, 1e9]], 3, axis=1)


def definite(rng, size):
    """A random positive definite matrix whose elements have the magnitudes size·sizeᵀ."""
    X = rng.standard_normal((6, 6))
    return (X @ X.T + 0.3 * np.eye(6)) * np.outer(size, size)


def mixing(rng, n):
    """A change of basis that costs hardly any digits: columns turned, then scaled."""
    return qr(rng.standard_normal((n, n)))[0] * 10 ** rng.uniform(-2, 2, n)


def case(seed, r):
    """A contact with two metrics of each kind; N and T from one orthogonal matrix, then mixed."""
    rng = default_rng([seed, r])
    size = SIZE * UNITS[seed]
    Q = qr(rng.standard_normal((6, 6)))[0]
    return SimpleNamespace(
        size=size,
        N=size[:, None] * (Q[:, :r] @ mixing(rng, r)),
        T=(Q[:, r:] @ mixing(rng, 6 - r)) / size[:, None],
        A=(definite(rng, size), definite(rng, size)),
        B=(definite(rng, 1 / size), definite(rng, 1 / size)),
    )


def inverse(A):
    inverted = inv(A)
    return 0.5 * (inverted + inverted.T)


def part(first, second, x):
    """The component of x in range(first) when the rest lies in range(second): eqs. 1 and 2."""
    return first @ solve(np.hstack((first, second)), x)[: first.shape[1]]


def close(got, expected, tolerance=1e-10):
    """Equal relative to the larger of the two, linear and angular rows each on their own scale."""
    assert got.shape == expected.shape
    for rows in (slice(0, 3), slice(3, 6)):
        scale = max(largest(expected[rows]), largest(got[rows]))
        assert largest(got[rows] - expected[rows]) <= tolerance * scale


def on_every_contact(test):
    return parametrize("r", range(7))(parametrize("seed", range(len(UNITS)))(test))


@on_every_contact
def test_every_projection_is_the_decomposition_it_stands_for(seed, r):
    """On a basis, so that ranges, kernels, Ω² = Ω and Ω + Ω̄ = 1 are those of the decomposition."""
    c = case(seed, r)
    A = c.A[0]
    B = c.B[0]
    forces = np.diag(c.size)
    motions = np.diag(1 / c.size)
    close(P.Omega_f(c.N, inverse(A)) @ forces, part(c.N, A @ c.T, forces))
    close(P.Omega_f_bar(c.T, A) @ forces, part(A @ c.T, c.N, forces))
    close(P.Omega_m(c.T, inverse(B)) @ motions, part(c.T, B @ c.N, motions))
    close(P.Omega_m_bar(c.N, B) @ motions, part(B @ c.N, c.T, motions))


@on_every_contact
def test_identities_9_to_12(seed, r):
    """Eqs. 10 and 12 need bars that are not printed; without them they hold for empty spaces."""
    c = case(seed, r)
    f1, f2 = (P.Omega_f(c.N, inverse(A)) for A in c.A)
    g1, g2 = (P.Omega_f_bar(c.T, A) for A in c.A)
    m1, m2 = (P.Omega_m(c.T, inverse(B)) for B in c.B)
    w1, w2 = (P.Omega_m_bar(c.N, B) for B in c.B)
    for one, other in ((f1, f2), (m1, m2)):
        close(one @ other, other)
    for one, other, none in ((g1, g2, f2), (w1, w2, m2)):
        close(one @ other, one)
        assert (np.abs(one @ none) <= 1e-10 * (np.abs(one) @ np.abs(none))).all()
        assert not 0 < r < 6 or largest(one @ other) > 1e-3


@parametrize("r", [1, 2, 3, 4, 5])
@parametrize("seed", range(len(UNITS)))
def test_rank_five_inverse_inertia_is_enough(seed, r):
    """Dual SCARA: Φ has rank 5, Λ does not exist; the laws are the limit of definite metrics."""
    c = case(seed, r)
    rng = default_rng([seed, r, 4])
    root = rng.standard_normal((6, 5)) / c.size[:, None]
    Phi = root @ root.T
    assert matrix_rank(Phi) == 5
    f = c.size * rng.standard_normal(6)
    alpha = lstsq(root.T @ c.N, root.T @ f, rcond=None)[0]
    projection = P.Omega_f(c.N, Phi)
    close(projection @ f, c.N @ alpha, 1e-8)
    close(P.Omega_m_bar(c.N, Phi), projection.T, 1e-8)
    # the limit: full-rank metrics closer and closer to Φ, extrapolated
    extra = definite(rng, 1 / c.size)
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
    N_prime = c.size[:, None] * rng.standard_normal((6, 6 - r))
    T_prime = rng.standard_normal((6, r)) / c.size[:, None]
    f = c.size * rng.standard_normal(6)
    v = rng.standard_normal(6) / c.size
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


# Null space ---------------------------------------------------------------------------------------


def test_null_space_of_pure_forces_and_pure_couples():
    for columns in (np.eye(6)[:, :2], np.eye(6)[:, 3:], 1e-6 * np.eye(6)[:, 5:]):
        T = P.null_space(columns)
        assert largest(columns.T @ T) <= 1e-15
        assert matrix_rank(np.hstack((columns / largest(columns), T))) == 6
