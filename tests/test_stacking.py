"""Several contacts at once: ranks, dependent contacts, and contacts given by what they permit."""

import numpy as np
import pinocchio as pin
from numpy.linalg import inv, lstsq, norm, svd
from numpy.random import default_rng
from numpy.testing import assert_allclose
from pair_kinds import Motion, pose_of
from pytest import approx, mark, raises
from rigs import largest, shift

from osc_contact.contacts.contact import Contact
from osc_contact.contacts.pairs import GapFunctions, VertexOnFace
from osc_contact.errors import ContactError, InvalidInputError

LEGS = 0.4 * np.array([[1.0, 1, -1], [1, -1, -1], [-1, -1, -1], [-1, 1, -1]])
UP = np.array([0.0, 0, 1])


def table(X_WO, V_O, X_WE, V_E):
    """Four legs on the plane z = 0 of E."""
    pairs = [VertexOnFace(p, np.zeros(3), UP, name=f"leg {i}") for i, p in enumerate(LEGS)]
    return [pair.contact(X_WO, V_O, X_WE, V_E) for pair in pairs]


def moving_table(seed):
    rng = default_rng(seed)
    X_WE = pose_of(rng)
    yaw = pin.exp3(rng.normal() * UP)
    standing = pin.SE3(yaw, np.array([*rng.standard_normal(2), 0.4]))
    return table(X_WE * standing, rng.standard_normal(6), X_WE, rng.standard_normal(6))


def mobility(rng):
    """Φ (6, 6) of a body about as large as the table."""
    turn = pin.exp3(rng.standard_normal(3))
    spread = turn @ np.diag(rng.uniform(0.6, 1.0, 3)) @ turn.T
    return inv(pin.Inertia(5.0, rng.uniform(-0.2, 0.2, 3), spread).matrix())


def all_columns(parts):
    return np.hstack([c.N for c in parts]), np.concatenate([c.n_gamma for c in parts])


@mark.parametrize("seed", range(4))
def test_a_table_on_four_legs_has_three_forces_and_a_split_that_is_not_unique(seed):
    """On a moving floor, moving at will; R leads back to N, n_γ and the least split."""
    rng = default_rng([seed, 1])
    parts = moving_table(seed)
    Phi = mobility(rng)
    N_all, n_all = all_columns(parts)
    for stacked in (Contact.stack(parts), Contact.stack(parts, Phi)):
        assert stacked.r == 3 and stacked.R.shape == (3, 4) and not stacked.split_is_unique
        assert all((N_all == column[:, None]).all(axis=0).any() for column in stacked.N.T)
        assert_allclose(stacked.N @ stacked.R, N_all, atol=1e-12)
        assert_allclose(stacked.n_gamma @ stacked.R, n_all, atol=1e-11)
        alpha = rng.standard_normal(3) * 20
        split = stacked.magnitudes(alpha)
        least = lstsq(N_all, stacked.N @ alpha, rcond=1e-9)[0]
        assert_allclose(split, least, atol=1e-10)
        assert_allclose(stacked.R @ split, alpha, atol=1e-11)  # and forth


def dependent_parts(rng):
    """Contacts of sizes 0 to 3, independent each, of rank 1 to 6 together; columns 1e-3 … 1e3."""
    rank = int(rng.integers(1, 7))
    basis = rng.standard_normal((6, rank))
    n_gamma = rng.standard_normal(rank)
    parts = []
    for _ in range(rng.integers(2, 6)):
        k = min(int(rng.integers(0, 4)), rank)
        mix = rng.standard_normal((rank, k)) * 10 ** rng.uniform(-3, 3, size=k)
        parts.append(Contact(basis @ mix, n_gamma @ mix))
    return parts, min(rank, sum(c.r for c in parts))


@mark.parametrize("seed", range(12))
def test_any_stack_nested_or_not_leads_back_to_all_its_columns(seed):
    rng = default_rng([seed, 2])
    parts, rank = dependent_parts(rng)
    N_all, n_all = all_columns(parts)
    half = len(parts) // 2
    nested = [Contact.stack(parts[:half]), Contact.stack(parts[half:])]
    for stacked in (
        Contact.stack(parts),
        Contact.stack(nested),
        Contact.stack(parts, mobility(rng)),
    ):
        assert stacked.r == rank
        assert stacked.split_is_unique == (N_all.shape[1] == rank)
        assert_allclose(stacked.N @ stacked.R, N_all, atol=1e-9 * largest(N_all))
        scale = largest(n_all)
        assert_allclose(stacked.n_gamma @ stacked.R, n_all, atol=1e-9 * scale)
        unit = stacked.N / norm(stacked.N, axis=0)
        everything = N_all / norm(N_all, axis=0)
        values = svd(everything, compute_uv=False)
        if rank:  # the columns kept are not much worse conditioned than all together
            assert svd(unit, compute_uv=False)[-1] > 0.02 * values[rank - 1]


@mark.parametrize("seed", range(4))
def test_the_contact_force_is_that_of_all_contacts_in_any_order(seed):
    """A free table pressed on four legs: against one multiplier for each leg, by least squares."""
    rng = default_rng([seed, 3])
    parts = moving_table(seed)
    Phi = mobility(rng)
    f = rng.standard_normal(6) * 30
    N_all, n_all = all_columns(parts)
    K = np.block([[inv(Phi), N_all], [N_all.T, np.zeros((4, 4))]])
    f_all = N_all @ lstsq(K, np.concatenate((f, n_all)), rcond=1e-12)[0][6:]
    for _ in range(5):
        stacked = Contact.stack([parts[i] for i in rng.permutation(4)], Phi)
        N = stacked.N
        alpha = np.linalg.solve(N.T @ Phi @ N, N.T @ Phi @ f - stacked.n_gamma)
        assert_allclose(N @ alpha, f_all, atol=1e-9 * largest(f_all))


# The verdict --------------------------------------------------------------------------------------


def change(rng):
    """Motions, forces, and power in other axes, about a point up to 100 m away, in mm and g."""
    X = pin.SE3(pin.exp3(rng.standard_normal(3)), rng.standard_normal(3) * 10 ** rng.uniform(-1, 2))
    motion = np.diag([1e3] * 3 + [1.0] * 3) @ X.toActionMatrix()
    return motion, 1e9 * inv(motion).T, 1e9


def parallel(y):
    """A force along z through (0, y, 0)."""
    return Contact(np.array([[0, 0, 1, y, 0, 0]]).T, [0.3])


@mark.parametrize(("apart", "r"), [(0.1, 2), (1e-6, 2), (1e-8, 2), (1e-13, 1), (0.0, 1)])
def test_the_rank_knows_no_frame_origin_basis_or_unit(apart, r):
    """Two parallel lines of force: 200 changes for each distance, the same verdict, map and force.

    The limit of 1e-10 is counted in the object's own size."""
    rng = default_rng(4)
    Phi = mobility(rng)
    lines = [parallel(0.1), parallel(0.1 + apart)]
    plain = Contact.stack(lines, Phi)
    assert plain.r == r
    for _ in range(200):
        motion, force, power = change(rng)
        size = 10 ** rng.uniform(-3, 3, size=2)  # of the columns
        moved = [Contact(force @ c.N * s, c.n_gamma * s) for c, s in zip(lines, size, strict=True)]
        stacked = Contact.stack(moved, motion @ Phi @ motion.T / power)
        assert stacked.r == r
        if apart == 0.0:
            assert stacked.magnitudes([1.0]) @ size == approx(size[0], rel=1e-9)
    far = Contact.stack([parallel(1e5), parallel(1e5 + 1e-6)])
    assert far.r == 1  # unit columns do depend on O: this is why Φ_ref is passed


# Velocity products --------------------------------------------------------------------------------


def test_contacts_that_no_acceleration_keeps_are_refused_by_name():
    """Point and normal in common, curvature not: at rest one contact, in motion none."""

    def gap(X):
        x, _, z = X.translation
        return np.array([z - 0.5 * x * x])

    flat = VertexOnFace(np.zeros(3), np.zeros(3), UP, name="flat")
    curved = GapFunctions(gap, name="curved")
    aside = VertexOnFace([0.0, 0.3, 0], np.zeros(3), UP, name="aside")
    here = pin.SE3.Identity()

    def stacked(speed):
        V = np.array([speed, 0, 0, 0, 0, 0])
        return Contact.stack([pair.contact(here, V) for pair in (aside, flat, curved)])

    assert stacked(0.0).r == 2
    with raises(ContactError) as refused:
        stacked(0.1)
    text = str(refused.value)
    assert text.startswith("flat, curved: singular at this instant") and "aside" not in text
    assert "needs n_γ = -0.01" in text and "imply 0" in text
    # rounding in n_γ is no contradiction
    N = stacked(0.0).N[:, 1:]
    assert Contact.stack([Contact(N, [5.0]), Contact(2 * N, [10.0 + 1e-8])]).r == 1
    with raises(ContactError, match="contact 0, contact 1: singular"):
        Contact.stack([Contact(N, [5.0]), Contact(2 * N, [10.001])])


@mark.parametrize("turn", range(2))
@mark.parametrize("name", ["cone_in_groove", "revolute", "screw", "cylinder_in_hole"])
def test_contacts_given_by_tangents_in_motion(name, turn):
    """n_γ = NᵀṪβ for whatever N was chosen: the differentiated poses keep the contact."""
    motion = Motion.keeping(name, turn)
    contact = motion.contact()
    (V_rel, a_rel) = motion.relative
    h = 1e-3

    def carried(t):
        """T at time t in one smooth basis, written at the operational point of t = 0."""
        X_WO = motion.body(t)
        X_WE = motion.env(t)
        T = motion.pair.contact(X_WO, np.zeros(6), X_WE).T
        away = shift(X_WO.translation - motion.body(0.0).translation)
        T = away.toActionMatrix() @ T
        return T @ inv(start.T @ T)  # any basis of T(t) becomes the same smooth one

    start = contact.T
    now = carried(0.0)
    rates = [(carried(k * h) - carried(-k * h)) / (2 * k * h) for k in (1, 2)]
    T_dot = (4 * rates[0] - rates[1]) / 3
    beta = lstsq(now, V_rel, rcond=None)[0]
    given = Contact.from_tangents(now, T_dot_beta=T_dot @ beta)
    assert given.r == contact.r and largest(given.N.T @ now) < 1e-12
    scale = 1.0 + largest(a_rel)
    assert_allclose(given.n_gamma, given.N.T @ a_rel, atol=1e-8 * scale)
    assert largest(given.n_gamma) > 1e-4


def test_tangents_with_two_rates_or_half_of_one_are_refused():
    T = np.eye(6)[:, :2]
    with raises(InvalidInputError, match="n_gamma or T_dot_beta"):
        Contact.from_tangents(T, np.zeros(4), T_dot_beta=np.zeros(6))
    with raises(InvalidInputError, match=r"T_dot_beta: expected shape \(6\)"):
        Contact.from_tangents(T, T_dot_beta=np.zeros(3))


# Refusals -----------------------------------------------------------------------------------------


def test_impossible_stacks_are_refused():
    parts = moving_table(0)
    for wrong, words in (
        (np.eye(3), "Phi_ref: expected shape"),
        (np.diag([1.0, 1, 1, 1, 1, 0]), "a diagonal element is not positive"),
        (np.eye(6) + 1e-3 * np.eye(6, k=1), "it is not symmetric"),
        (np.ones((6, 6)) + np.diag([0.0] * 5 + [1]), "positive definite"),
    ):
        with raises(InvalidInputError, match=words):
            Contact.stack(parts, wrong)
    with raises(InvalidInputError, match=r"alpha: expected shape \(3\)"):
        Contact.stack(parts).magnitudes(np.ones(4))
    with raises(ContactError, match="NᵀT ≠ 0: column 0 of N does the power 1 on column 1"):
        Contact(np.eye(6)[:, :4], T=np.eye(6)[:, [4, 0]])
    with raises(ContactError, match=r"T: columns \[0, 1\] are dependent"):
        Contact(np.eye(6)[:, :4], T=np.eye(6)[:, [4, 4]])
