"""Columns that are nearly dependent, and metrics that are singular: accepted with all digits, or
refused, and nothing in between. On every BLAS kernel alike."""

import numpy as np
import pinocchio as pin
from complaints import contact_error
from numpy.random import default_rng
from pytest import fixture, mark
from rigs import assert_near, largest
from samples import aligned, parametrize
from scenario_runs import rig_of
from test_projections import SIZE, close, mixing

import osc_contact as osc
from osc_contact import projections as P

FORCE_LAWS = (P.Omega_f, P.Omega_m_bar)
MOTION_LAWS = (P.Omega_m, P.Omega_f_bar)


@fixture(params=[0.01, 1.0, 100.0], ids=["stricter", "as is", "laxer"])
def limits(request, monkeypatch):
    """Limits a hundred times larger or smaller, which must not change any verdict."""
    for name in ("DEPENDENT", "BLOCKED", "BLURRED", "_LEAST_MOBILITY"):
        monkeypatch.setattr(P, name, getattr(P, name) * request.param)


def orthogonal(rng):
    return np.linalg.qr(rng.standard_normal((6, 6)))[0]


def metric(rng, size, rank):
    """A random metric of rank 5 or 6; its scaled eigenvalues within a factor of about 300."""
    root = orthogonal(rng)[:, :rank] * 10 ** rng.uniform(-1.2, 0.0, rank) * size[:, None]
    return root @ root.T


def nearly_dependent(rng, r, gap):
    """Columns (6, r), one pair `gap` apart in direction, and good ones that span the same."""
    good = SIZE[:, None] * orthogonal(rng)[:, :r]
    near = good.copy()
    near[:, -1] = good[:, 0] + gap * good[:, -1]
    return (near, good)


def changes(rng):
    """As it is, from another point and in other axes, in millimetres, and both.

    Another point lies up to 2 m away; motions are carried by X, forces by X*.
    """
    X = pin.SE3(pin.exp3(2.0 * rng.standard_normal(3)), rng.uniform(-2.0, 2.0, 3))
    one = (X.action, X.dualAction)
    other = (np.diag([1e3] * 3 + [1.0] * 3), np.diag([1.0] * 3 + [1e3] * 3))  # power in N mm/s
    yield (np.eye(6), np.eye(6))
    yield one
    yield other
    yield (other[0] @ one[0], other[1] @ one[1])


@parametrize("gap", [1e-4, 1e-5, 1e-6])
@parametrize("rank", [5, 6])
@parametrize("seed", range(4))
def test_nearly_dependent_columns_project_as_good_ones_in_every_frame_unit_and_basis(
    seed, rank, gap
):
    """Up to what the columns' own last digit, 1e-16 / gap, makes of the space they span."""
    rng = default_rng([seed, rank, 2])
    r = 2 + seed % 4
    near, good = nearly_dependent(rng, r, gap)
    Phi = metric(rng, 1 / SIZE, rank)
    f = SIZE * rng.standard_normal(6)
    v = rng.standard_normal(6) / SIZE
    for X, X_f in changes(rng):
        for basis in (np.eye(r), np.diag(10 ** rng.uniform(-3, 3, r))):
            given = (X_f @ near @ basis, X @ Phi @ X.T)
            for law, x, way in ((P.Omega_f, f, X_f), (P.Omega_m_bar, v, X)):
                found = np.linalg.solve(way, law(*given) @ way @ x)
                close(found, law(good, Phi) @ x, 3e-13 / gap)


@mark.usefixtures("limits")
@parametrize("rank", [5, 6])
@parametrize("seed", range(4))
def test_columns_a_millionth_apart_are_accepted_in_every_frame(seed, rank):
    rng = default_rng([seed, rank, 3])
    near, _ = nearly_dependent(rng, 2 + seed % 4, 1e-6)
    force = metric(rng, 1 / SIZE, rank)
    motion = metric(rng, SIZE, rank)
    for X, X_f in changes(rng):
        for law in FORCE_LAWS + MOTION_LAWS:
            law(X_f @ near, X @ force @ X.T)
        for law in MOTION_LAWS:
            law(P.null_space(X_f @ near), X_f @ motion @ X_f.T)


@mark.usefixtures("limits")
@parametrize("r", [1, 2, 3, 4, 5])
def test_singular_metrics_are_refused_in_every_frame(r):
    """Φn = 0 for a column n, for a combination, and for one of columns that are hardly apart."""
    rng = default_rng([r, 4])
    for _ in range(60):
        Q = orthogonal(rng)
        root = Q[:, 1:] * 10 ** rng.uniform(-1.2, 0.0, 5) / SIZE[:, None]
        Phi = root @ root.T  # and Φ SIZE Q[:, 0] = 0
        N = SIZE[:, None] * np.hstack((Q[:, :1], rng.standard_normal((6, r - 1))))
        near = N.copy()
        near[:, 0] = N[:, -1] + 1e-6 * N[:, 0]
        for X, X_f in changes(rng):
            for columns in (N, N @ mixing(rng, r), *([near] if r > 1 else [])):
                for law in FORCE_LAWS:
                    with contact_error("cannot move along"):
                        law(X_f @ columns, X @ Phi @ X.T)


@mark.usefixtures("limits")
@parametrize("k", [2, 3, 4, 5, 6, 7])
def test_dependent_columns_are_refused_in_every_frame(k):
    rng = default_rng([k, 5])
    for rank in 30 * (5, 6):
        N = SIZE[:, None] * rng.standard_normal((6, k))
        N[:, -1] = N[:, :-1] @ rng.standard_normal(k - 1)
        Phi = metric(rng, 1 / SIZE, rank)
        for X, X_f in changes(rng):
            for law in FORCE_LAWS + MOTION_LAWS:
                with contact_error("dependent"):
                    law(X_f @ N, X @ Phi @ X.T)


def test_messages_name_the_columns():
    e = np.eye(6)
    singular = np.diag([1.0, 1.0, 0.0, 1.0, 1.0, 1.0])
    for columns, Phi, words in (
        ((e[0], e[2]), singular, r"column 1 has nᵀΦn = 0, .* Drop that contact"),
        (
            (e[0], e[1] + e[2], e[1] - e[2]),
            singular,
            r"columns \[1, 2\] are dependent in the metric",
        ),
        ((e[0], e[1], -3.0 * e[0]), e, r"columns \[0, 2\] are dependent \(least"),
    ):
        with contact_error(words):
            P.Omega_f(np.column_stack(columns), Phi)


def test_the_law_of_two_contacts_hardly_apart_is_that_of_good_columns():
    """Eqs. 17 and 18 on the rod; columns 1e-4 apart are as near as a law accepts."""
    rig = rig_of()
    rng = default_rng(8)
    state = rig.model.state(rig.q_contact, 0.3 * rng.standard_normal(len(rig.q_contact)))
    good = rig.contact.N
    gap = 1e-4
    C = np.array([[1.0, 1.0], [0.0, gap]])  # N = good C
    Phi_e = np.diag([0.1, 0.2, 0.3, 1.0, 2.0, 3.0])
    for environment in (osc.Environment.fixed(), osc.Environment(Phi_e, rng.standard_normal(6))):
        n_gamma = rng.standard_normal(2)
        f_S = rng.standard_normal(state.d)
        found = []
        for N, n_g in ((good @ C, n_gamma @ C), (good, n_gamma)):
            answer = osc.contact_response(state, osc.Contact(N, n_g), environment, f_S=f_S)
            found.append([answer.f_c, answer.acceleration])
        for one, other in aligned(*found):
            assert_near(one, other, atol=1e-10 * largest(other), rtol=0.0)
