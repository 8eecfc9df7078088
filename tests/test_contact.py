"""Contact states: what they accept and refuse; several at once, dependent ones among them."""

import numpy as np
import pinocchio as pin
from complaints import contact_error
from numpy.linalg import inv, matrix_rank, norm, pinv, svd
from numpy.random import default_rng
from numpy.testing import assert_array_equal
from pytest import approx
from rigs import any_rotation, assert_near, largest, refused, within
from samples import aligned, parametrize

from osc_contact import projections
from osc_contact.contacts.contact import Contact


def random_normals(seed, r):
    """r lines of force through points within 0.5 m of O, with couples, magnitudes 0.01 to 100."""
    rng = default_rng([seed, r])
    return rng.standard_normal((6, r)) * 10 ** rng.uniform(-2, 2, r)


def assert_complete(N, T):
    """NᵀT = 0 against the size of the summands, six columns in all, both of full rank."""
    assert within(N.T @ T, 1e-12 * (np.abs(N).T @ np.abs(T)))
    assert N.shape[1] + T.shape[1] == 6
    for columns in (N, T):
        assert matrix_rank(columns, tol=1e-9) == columns.shape[1]


@parametrize("r", range(7))
@parametrize("seed", range(3))
def test_tangents_are_all_motions_without_power(seed, r):
    """And normals all forces without it; methods pass on the projections."""
    N = random_normals(seed, r)
    given = N.copy()
    contact = Contact(given)
    given[:] = np.nan  # it has its own
    assert contact.r == r
    assert_complete(N, contact.T)
    free = np.eye(6) - pinv(N.T) @ N.T  # any motion without power
    assert matrix_rank(np.hstack((contact.T, free)), tol=1e-9) == 6 - r
    assert contact.T is contact.T  # computed once
    assert_array_equal(contact.N, N)
    assert_array_equal(contact.n_gamma, np.zeros(r))
    T = random_normals(seed, 6 - r)
    X = default_rng([seed, 99]).standard_normal((6, 6))
    given = Contact.from_tangents(T, np.arange(r))
    moving = Contact.from_tangents(T, T_dot_beta=X[0])
    for other, n_gamma in ((given, np.arange(r)), (moving, moving.N.T @ X[0])):
        assert other.r == r
        assert_array_equal(other.T, T)
        assert_array_equal(other.n_gamma, n_gamma)
        assert_complete(other.N, T)
    metric = X @ X.T + 0.1 * np.eye(6)
    for got, law, of, A in (
        (contact.force_projection, projections.Omega_f, N, metric),
        (contact.motion_projection, projections.Omega_m, contact.T, inv(metric)),
    ):
        assert_near(got(metric), law(of, A), atol=1e-8, rtol=1e-8)


# Several at once ----------------------------------------------------------------------------------


def mobility(rng):
    """Φ (6, 6) of a body about as large as the table."""
    turn = any_rotation(rng)
    spread = turn @ np.diag(rng.uniform(0.6, 1.0, 3)) @ turn.T
    return inv(pin.Inertia(5.0, rng.uniform(-0.2, 0.2, 3), spread).matrix())


@parametrize("seed", range(24))
def test_any_stack_nested_or_not_leads_back_to_all_its_columns(seed):
    """Contacts of sizes 0 to 3, independent each, of rank 1 to 6 together; columns 1e-3 … 1e3.

    Where all are independent they keep their order.
    """
    rng = default_rng([seed, 2])
    rank = int(rng.integers(1, 7))
    basis = rng.standard_normal((6, rank))
    n_gamma = rng.standard_normal(rank)
    parts = []
    for _ in range(rng.integers(2, 6)):
        k = min(int(rng.integers(0, 4)), rank)
        mix = rng.standard_normal((rank, k)) * 10 ** rng.uniform(-3, 3, k)
        parts.append(Contact(basis @ mix, n_gamma @ mix))
    N_all = np.hstack([c.N for c in parts])
    n_all = np.concatenate([c.n_gamma for c in parts])
    rank = matrix_rank(N_all / norm(N_all, axis=0), tol=1e-9) if N_all.size else 0
    half = len(parts) // 2
    nested = [Contact.stack(some) for some in ([], parts[:half], parts[half:])]
    for given in ((parts,), (nested,), (parts, mobility(rng))):
        stacked = Contact.stack(*given)
        assert stacked.r == rank and stacked.split_is_unique == (N_all.shape[1] == rank)
        assert_near(stacked.N @ stacked.R, N_all, atol=1e-9 * largest(N_all))
        assert_near(stacked.n_gamma @ stacked.R, n_all, atol=1e-9 * largest(n_all))
        alpha = rng.standard_normal(stacked.r)
        split = stacked.magnitudes(alpha)
        assert_near(stacked.R @ split, alpha, atol=1e-9)
        assert_near(pinv(stacked.R) @ alpha, split, atol=1e-9)  # the least one
        if stacked.split_is_unique:
            assert_array_equal(stacked.N, N_all)
            assert_array_equal(stacked.n_gamma, n_all)
        if stacked.r:  # the columns kept are not much worse conditioned than all together
            least = svd(stacked.N / norm(stacked.N, axis=0))[1][-1]
            assert least > 0.02 * svd(N_all / norm(N_all, axis=0))[1][stacked.r - 1]


def parallel(y):
    """A force along z through (0, y, 0)."""
    return Contact(np.array([[0, 0, 1, y, 0, 0]]).T, [0.3])


@parametrize("apart, r", {0.1: 2, 1e-6: 2, 1e-8: 2, 1e-13: 1, 0.0: 1})
def test_the_rank_knows_no_frame_origin_basis_or_unit(apart, r):
    """Two parallel lines of force: 200 changes for each distance, the same verdict, map and force.

    Other axes, about a point up to 100 m away, in mm and g. The limit of 1e-10 is counted in the
    object's own size.
    """
    rng = default_rng(4)
    Phi = mobility(rng)
    lines = [parallel(0.1), parallel(0.1 + apart)]
    assert Contact.stack(lines, Phi).r == r
    for _ in range(200):
        away = rng.standard_normal(3) * 10 ** rng.uniform(-1, 2)
        X = pin.SE3(any_rotation(rng), away)
        motion = np.diag([1e3] * 3 + [1.0] * 3) @ X.toActionMatrix()
        force = 1e9 * inv(motion).T
        size = 10 ** rng.uniform(-3, 3, 2)  # of the columns
        moved = [Contact(force @ c.N * s, c.n_gamma * s) for c, s in aligned(lines, size)]
        stacked = Contact.stack(moved, motion @ Phi @ motion.T / 1e9)
        assert stacked.r == r
        if apart == 0.0:
            assert stacked.magnitudes([1.0]) @ size == approx(size[0], rel=1e-9)
    far = Contact.stack([parallel(1e5), parallel(1e5 + 1e-6)])
    assert far.r == 1  # unit columns do depend on O: this is why Φ_ref is passed


# Velocity products --------------------------------------------------------------------------------


def test_contacts_that_no_acceleration_keeps_are_refused_by_name():
    """Point and normal in common, curvature not: at rest one contact, in motion none."""
    flat, aside = np.hsplit(random_normals(4, 2), 2)
    parts = [Contact(aside, [0.0], name="aside"), Contact(flat, [0.0], name="flat")]
    assert Contact.stack([*parts, Contact(flat, [0.0], name="curved")]).r == 2
    with contact_error("^flat, curved: singular at this instant.*needs n_γ = -0.01.*imply 0"):
        Contact.stack([*parts, Contact(flat, [-0.01], name="curved")])
    # rounding in n_γ is no contradiction
    assert Contact.stack([Contact(flat, [5.0]), Contact(2 * flat, [10.0 + 1e-8])]).r == 1
    with contact_error("contact 0, contact 1: singular"):
        Contact.stack([Contact(flat, [5.0]), Contact(2 * flat, [10.001])])


# Refusals -----------------------------------------------------------------------------------------


TWO = np.eye(6)[:, :2]


@parametrize(
    "make, given, message",
    [
        (Contact, [np.zeros((5, 1))], r"N: expected shape \(6, any\), got \(5, 1\)"),
        (Contact, [TWO, [1.0]], r"n_gamma: expected shape \(2\), got \(1,\)"),
        (Contact.stack, [[Contact(TWO)], np.eye(3)], "Phi_ref: expected shape"),
        *(
            (Contact.stack, [[Contact(TWO)], Phi], words)
            for Phi, words in (
                (
                    np.diag([1.0, 1, 1, 1, 1, 0]),
                    r"not symmetric positive definite \(diagonal \[1. 1. 1. 1. 1. 0.\]",
                ),
                (np.eye(6) + 1e-3 * np.eye(6, k=1), "Phi_ref is not symmetric"),
                (np.ones((6, 6)) + np.diag([0.0] * 5 + [1]), "positive definite"),
            )
        ),
        (Contact(TWO).magnitudes, [np.ones(4)], r"alpha: expected shape \(2\)"),
    ],
)
def test_malformed_input_is_refused(make, given, message):
    with refused(message):
        make(*given)
    with refused("n_gamma or T_dot_beta"):
        Contact.from_tangents(TWO, np.zeros(4), T_dot_beta=np.zeros(6))
    with refused(r"T_dot_beta: expected shape \(6\)"):
        Contact.from_tangents(TWO, T_dot_beta=np.zeros(3))


def columns(change):
    N = random_normals(3, 4)
    N[:, 3] = change(N / norm(N, axis=0))
    return N


@parametrize(
    "N, message",
    [
        (columns(lambda n: 0.0 * n[:, 0]), "column 3 is zero"),
        *(
            (
                columns(lambda n, s=size: s * (n[:, 0] - n[:, 2])),
                r"columns \[0, 2, 3\] are dependent",
            )
            for size in (1e-4, 1.0, 1e4)
        ),
        (random_normals(0, 7), "7 columns"),
        (np.hstack((parallel(0.0).N, parallel(1e-11).N)), "dependent"),
    ],
)
def test_zero_dependent_and_too_many_columns_are_refused_by_number(N, message):
    with contact_error(f"N: .*{message}"):
        Contact(N)
    with contact_error(f"T: .*{message}"):
        Contact.from_tangents(N)


def test_normals_and_tangents_that_do_power_on_one_another_are_refused():
    N = np.eye(6)[:, :4]
    with contact_error("NᵀT ≠ 0: column 0 of N does the power 1 on column 1"):
        Contact(N, T=np.eye(6)[:, [4, 0]])
    with contact_error(r"T: columns \[0, 1\] are dependent"):
        Contact(N, T=np.eye(6)[:, [4, 4]])
