"""A contact state: what it accepts, what it refuses, and that it only passes on the projections."""

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
from pytest import mark, raises

from osc_contact import projections
from osc_contact.contacts.contact import Contact
from osc_contact.errors import ContactError, InvalidInputError, OscContactError

RANKS = range(7)
SEEDS = range(3)


def random_normals(seed, r):
    """r lines of force through points within 0.5 m of O, with couples, magnitudes 0.01 to 100."""
    rng = np.random.default_rng([seed, r])
    return rng.normal(size=(6, r)) * 10 ** rng.uniform(-2, 2, size=r)


def definite(seed):
    X = np.random.default_rng([seed, 99]).normal(size=(6, 6))
    return X @ X.T + 0.1 * np.eye(6)


def orthogonal(N, T, tolerance=1e-12):
    """NᵀT = 0 against the size of the summands."""
    return bool((np.abs(N.T @ T) <= tolerance * (np.abs(N).T @ np.abs(T))).all())


@mark.parametrize("r", RANKS)
@mark.parametrize("seed", SEEDS)
def test_tangents_are_all_motions_without_power(seed, r):
    N = random_normals(seed, r)
    contact = Contact(N)
    assert contact.r == r
    assert contact.T.shape == (6, 6 - r)
    assert orthogonal(N, contact.T)
    assert np.linalg.matrix_rank(contact.T, tol=1e-9) == 6 - r
    # any motion without power is a combination of the columns of T
    free = np.eye(6) - np.linalg.pinv(N.T) @ N.T
    assert np.linalg.matrix_rank(np.hstack((contact.T, free)), tol=1e-9) == 6 - r
    assert contact.T is contact.T  # computed once
    assert_array_equal(contact.N, N)
    assert_array_equal(contact.n_gamma, np.zeros(r))


def test_a_contact_keeps_its_own_copy():
    N = np.eye(6)[:, :1]
    n_gamma = np.ones(1)
    contact = Contact(N, n_gamma)
    N[:] = 0.0
    n_gamma[:] = 0.0
    assert contact.N[0, 0] == 1.0 and contact.n_gamma[0] == 1.0
    assert repr(contact) == "Contact(r=1)"
    assert Contact([[0], [0], [1], [0], [0], [0]]).N.dtype == np.float64


@mark.parametrize("r", RANKS)
@mark.parametrize("seed", SEEDS)
def test_from_tangents(seed, r):
    T = random_normals(seed, 6 - r)
    n_gamma = np.arange(r, dtype=float)
    contact = Contact.from_tangents(T, n_gamma)
    assert contact.r == r and contact.N.shape == (6, r)
    assert_array_equal(contact.T, T)
    assert_array_equal(contact.n_gamma, n_gamma)
    assert orthogonal(contact.N, T)
    assert np.linalg.matrix_rank(contact.N, tol=1e-9) == r


@mark.parametrize("seed", SEEDS)
def test_stack_keeps_the_order(seed):
    N = random_normals(seed, 4)
    n_gamma = np.array([1.0, -2.0, 3.0, -4.0])
    parts = [
        Contact(N[:, :1], n_gamma[:1]),
        Contact(N[:, :0]),
        Contact(N[:, 1:3], n_gamma[1:3]),
        Contact(N[:, 3:], n_gamma[3:]),
    ]
    stacked = Contact.stack(parts)
    assert_array_equal(stacked.N, N)
    assert_array_equal(stacked.n_gamma, n_gamma)
    assert stacked.r == 4 and orthogonal(N, stacked.T)


def test_no_contact_at_all():
    for free in (Contact.stack([]), Contact(np.zeros((6, 0))), Contact.from_tangents(np.eye(6))):
        assert free.r == 0
        assert free.N.shape == (6, 0) and free.n_gamma.shape == (0,)
        assert_array_equal(free.T, np.eye(6))
        assert_array_equal(free.force_projection(np.eye(6)), np.zeros((6, 6)))
        assert_array_equal(free.motion_projection(np.eye(6)), np.eye(6))


def test_clamped():
    for clamped in (Contact(np.eye(6)), Contact.from_tangents(np.zeros((6, 0)))):
        assert clamped.r == 6 and clamped.T.shape == (6, 0)
        assert_allclose(clamped.force_projection(definite(0)), np.eye(6), atol=1e-12)
        assert_allclose(clamped.motion_projection(definite(0)), 0.0, atol=1e-12)


@mark.parametrize("r", RANKS)
@mark.parametrize("seed", SEEDS)
def test_methods_pass_on_the_projections(seed, r):
    contact = Contact(random_normals(seed, r))
    metric = definite(seed)
    inverted = np.linalg.inv(metric)
    near = {"rtol": 1e-8, "atol": 1e-8}
    assert_array_equal(contact.force_projection(metric), projections.Omega_f(contact.N, metric))
    assert_array_equal(
        contact.motion_complement(metric), projections.Omega_m_bar(contact.N, metric)
    )
    assert_allclose(
        contact.force_complement(metric), projections.Omega_f_bar(contact.T, inverted), **near
    )
    assert_allclose(
        contact.motion_projection(metric), projections.Omega_m(contact.T, inverted), **near
    )


# Refusals -----------------------------------------------------------------------------------------


@mark.parametrize(
    ("N", "message"),
    [
        (np.zeros(6), r"N: expected shape \(6, any\), got \(6,\)"),
        (np.zeros((5, 1)), r"N: expected shape \(6, any\), got \(5, 1\)"),
        (np.zeros((1, 6)), r"got \(1, 6\)"),
        (np.full((6, 1), np.nan), r"N: element \(0, 0\) is nan"),
        (
            np.array([[1.0, 0, 0, 0, 0, 0], [0, 0, 0, 0, 0, np.inf]]).T,
            r"N: element \(5, 1\) is inf",
        ),
        ("normals", "N: expected numbers"),
    ],
)
def test_malformed_normals_are_refused(N, message):
    with raises(InvalidInputError, match=message):
        Contact(N)


@mark.parametrize(
    ("n_gamma", "message"),
    [
        ([1.0], r"n_gamma: expected shape \(2\), got \(1,\)"),
        (1.0, r"n_gamma: expected shape \(2\), got \(\)"),
        ([[1.0, 2.0]], r"n_gamma: expected shape \(2\), got \(1, 2\)"),
        ([0.0, np.nan], r"n_gamma: element \(1,\) is nan"),
    ],
)
def test_malformed_n_gamma_is_refused(n_gamma, message):
    with raises(InvalidInputError, match=message):
        Contact(np.eye(6)[:, :2], n_gamma)
    with raises(InvalidInputError, match=message):
        Contact.from_tangents(np.eye(6)[:, :4], n_gamma)


@mark.parametrize("column", range(3))
def test_zero_columns_are_refused_by_number(column):
    N = random_normals(0, 3)
    N[:, column] = 0.0
    with raises(ContactError, match=f"N: column {column} is zero"):
        Contact(N)
    with raises(ContactError, match=f"T: column {column} is zero"):
        Contact.from_tangents(N)


@mark.parametrize("size", [1e-4, 1.0, 1e4])
def test_dependent_columns_are_refused_by_number(size):
    N = random_normals(3, 4)
    N[:, 3] = size * (N[:, 0] / np.linalg.norm(N[:, 0]) - N[:, 2] / np.linalg.norm(N[:, 2]))
    with raises(ContactError, match=r"N: columns \[0, 2, 3\] are dependent"):
        Contact(N)
    with raises(ContactError, match=r"T: columns \[0, 2, 3\] are dependent"):
        Contact.from_tangents(N)


def test_nearly_dependent_is_not_dependent():
    """Two parallel lines of force a micrometre apart still carry two separate magnitudes."""
    N = np.array([[0, 0, 1.0, 0, 0, 0], [0, 0, 1.0, 1e-6, 0, 0]]).T
    assert Contact(N).r == 2
    N[3, 1] = 1e-11
    with raises(ContactError, match="dependent"):
        Contact(N)


def test_more_than_six_columns_are_refused():
    seven = random_normals(0, 7)
    with raises(ContactError, match="N: 7 columns"):
        Contact(seven)
    with raises(ContactError, match="T: 7 columns"):
        Contact.from_tangents(seven)


def test_refusals_share_the_base_class():
    for wrong in (np.zeros((6, 1)), np.zeros(6)):
        with raises(OscContactError):
            Contact(wrong)
