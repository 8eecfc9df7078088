"""A contact state: what it accepts, what it refuses, and that it only passes on the projections."""

import numpy as np
from numpy.linalg import matrix_rank
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from pytest import mark, raises
from rigs import refused

from osc_contact import projections
from osc_contact.contacts.contact import Contact
from osc_contact.errors import ContactError, OscContactError

RANKS = range(7)
SEEDS = range(3)


def random_normals(seed, r):
    """r lines of force through points within 0.5 m of O, with couples, magnitudes 0.01 to 100."""
    rng = default_rng([seed, r])
    return rng.standard_normal((6, r)) * 10 ** rng.uniform(-2, 2, size=r)


def definite(seed):
    X = default_rng([seed, 99]).standard_normal((6, 6))
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
    assert matrix_rank(contact.T, tol=1e-9) == 6 - r
    # any motion without power is a combination of the columns of T
    free = np.eye(6) - np.linalg.pinv(N.T) @ N.T
    assert matrix_rank(np.hstack((contact.T, free)), tol=1e-9) == 6 - r
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
    assert matrix_rank(contact.N, tol=1e-9) == r


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
    ("given", "message"),
    [
        ((np.zeros(6),), r"N: expected shape \(6, any\), got \(6,\)"),
        ((np.zeros((5, 1)),), r"N: expected shape \(6, any\), got \(5, 1\)"),
        ((np.full((6, 1), np.nan),), r"N: element \(0, 0\) is nan"),
        (("normals",), "N: expected numbers"),
        ((np.eye(6)[:, :2], [1.0]), r"n_gamma: expected shape \(2\), got \(1,\)"),
        ((np.eye(6)[:, :2], 1.0), r"n_gamma: expected shape \(2\), got \(\)"),
        ((np.eye(6)[:, :2], [0.0, np.nan]), r"n_gamma: element \(1,\) is nan"),
    ],
)
def test_malformed_contacts_are_refused(given, message):
    with refused(message):
        Contact(*given)


def columns(change):
    N = random_normals(3, 4)
    N[:, 3] = change(N / np.linalg.norm(N, axis=0))
    return N


@mark.parametrize(
    ("N", "message"),
    [
        (columns(lambda n: 0.0 * n[:, 0]), "column 3 is zero"),
        *(
            (
                columns(lambda n, size=size: size * (n[:, 0] - n[:, 2])),
                r"columns \[0, 2, 3\] are dependent",
            )
            for size in (1e-4, 1.0, 1e4)
        ),
        (random_normals(0, 7), "7 columns"),
    ],
)
def test_zero_dependent_and_too_many_columns_are_refused_by_number(N, message):
    with raises(ContactError, match=f"N: {message}"):
        Contact(N)
    with raises(ContactError, match=f"T: {message}"):
        Contact.from_tangents(N)


def test_nearly_dependent_is_not_dependent():
    """Two parallel lines of force a micrometre apart still carry two separate magnitudes."""
    N = np.array([[0, 0, 1.0, 0, 0, 0], [0, 0, 1.0, 1e-6, 0, 0]]).T
    assert Contact(N).r == 2
    N[3, 1] = 1e-11
    with raises(OscContactError, match="dependent"):
        Contact(N)
