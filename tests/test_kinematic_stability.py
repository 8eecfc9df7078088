"""Kinematic stability: eigenvalues against a closed loop differentiated numerically."""

from functools import cache

import numpy as np
import pinocchio as pin
from command_line import done, read_json
from numpy.linalg import eigvals, inv, solve
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from pytest import approx
from rigs import LWA, data_at, displacement, largest, rotated
from samples import aligned, names_in

from paper import kinematic_stability as ks
from paper.kinematic_stability import eigenvalues, regularity

#: s: damping = this times stiffness, in both laws. The two poles of an eigenvalue λ, roots of
#: z² + DAMPING_S λ z + λ, add up to −DAMPING_S λ: Re λ < 0 is unstable for every such damping.
DAMPING_S = 0.08


@cache
def found():
    return ks.search(0, 400)


# Both control laws, written with Pinocchio alone -----------------------------


def tip_pose(q):
    model, tip = ks.ur5()
    return data_at(model, q).oMf[tip].copy()


def jacobian(q):
    model, tip = ks.ur5()
    return pin.computeFrameJacobian(model, model.createData(), q, tip, LWA)


def torques(q, v, acceleration):
    model, _ = ks.ur5()
    return pin.rnea(model, model.createData(), q, v, acceleration)


def oracle_classic(q, v, goal):
    """Joint stiffness on the filtered error."""
    J = jacobian(q)
    S = np.diag([row != ks.FORCE for row in range(6)]).astype(float)
    q_e = inv(J) @ S @ (displacement(goal, tip_pose(q)) + DAMPING_S * J @ v)
    return torques(q, v, np.zeros(6)) - ks.K_Q @ q_e


def oracle_ours(q, v, goal):
    """The joint acceleration nearest to the desired one in the object's energy that keeps off the
    face."""
    X = tip_pose(q)
    J = jacobian(q)
    Lambda = rotated(X.rotation).act(ks.HELD).matrix()
    a_u = -inv(Lambda) @ ks.K_PRIME @ (displacement(goal, X) + DAMPING_S * J @ v)
    across = J[ks.FORCE]
    KKT = np.block([[J.T @ Lambda @ J, across[:, None]], [across[None], np.zeros((1, 1))]])
    qdd = solve(KKT, np.append(J.T @ Lambda @ a_u, 0.0))[:-1]
    return torques(q, v, qdd)


def numeric_poles(law, q0, h=1e-5):
    """Eigenvalues of the closed loop (q, v) → (v, aba), by central differences; the two of the
    direction nobody holds (0, 0) left out."""
    n = len(q0)
    model, _ = ks.ur5()
    data = model.createData()
    goal = tip_pose(q0)

    def rate(x):
        q = x[:n]
        v = x[n:]
        return np.append(v, pin.aba(model, data, q, v, law(q, v, goal)))

    start = np.append(q0, np.zeros(n))
    A = np.column_stack(
        [(rate(start + h * e) - rate(start - h * e)) / (2 * h) for e in np.eye(2 * n)]
    )
    values = eigvals(A)
    values = values[np.argsort(np.abs(values))]
    assert largest(values[:2]) < 0.05
    return np.sort_complex(values[2:])


def poles(eigenvalues):
    """Roots of z² + DAMPING_S λ z + λ: the poles (1/s) that the eigenvalues λ give."""
    half = -0.5 * DAMPING_S * eigenvalues
    root = np.sqrt(half**2 - eigenvalues.astype(complex))
    return np.sort_complex(np.append(half - root, half + root))


def assert_same_poles(got, expected):
    """Compare poles as sets: each has a partner."""
    distance = np.abs(got[:, None] - expected[None, :])
    scale = largest(expected)
    assert distance.min(axis=0).max() < 2e-4 * scale and distance.min(axis=1).max() < 2e-4 * scale


def test_ours_is_real_and_positive_next_to_singularities():
    """Elbow and wrist all but straight: J is as good as singular there."""
    rng = default_rng(5)
    unstable = 0
    for _ in range(60):
        q = rng.uniform(-np.pi, np.pi, 6)
        for joint in (2, 4):
            q[joint] = rng.choice([-1.0, 1.0]) * 10.0 ** rng.uniform(-4.0, -2.0)
        assert regularity(q) < 1e-4
        classic, ours = eigenvalues(q)
        assert largest(ours.imag) < 1e-6 * ours.real.min() and ours.real.min() > 1.0
        unstable += classic.real.min() < 0.0
    assert unstable > 5, "here the classic scheme has a hard time"


def test_ours_is_real_and_positive_for_any_contact_metric_and_stiffness():
    rng = default_rng(6)
    for _ in range(300):
        s = rng.integers(1, 7)
        A, C = rng.standard_normal((2, 6, 6))
        B = A @ A.T + 0.01 * np.eye(6)
        values = ks.our_eigenvalues(rng.standard_normal((6, s)), B, C @ C.T + 0.01 * np.eye(6))
        assert len(values) == s
        assert values.real.min() > 0.0
        assert largest(values.imag) < 1e-6 * largest(values)


def test_it_is_the_selection_that_makes_the_classic_scheme_unstable():
    q, _ = found()
    M, J, _ = ks.terms(q)
    everything = ks.classic_eigenvalues(M, J, np.ones(6), ks.K_Q)
    assert everything.real.min() > 10.0 and eigenvalues(q)[0].real.min() < -10.0


def test_search_counts_what_it_reports():
    """Repeats the draw: regular postures, and the least real part of each."""
    q, counts = ks.search(4, 400, 0.6)
    drawn = default_rng(4).uniform(-np.pi, np.pi, (400, 6))
    judged = sorted(drawn, key=lambda q: -regularity(q))[:240]
    least = np.array([eigenvalues(q)[0].real.min() for q in judged])
    assert (counts["postures_drawn"], counts["postures"], counts["ours_unstable"]) == (400, 240, 0)
    assert counts["classic_unstable"] == (least < -1e-6).sum() > 0
    assert_array_equal(q, judged[least.argmin()])
    assert counts["classic_eigenvalues"][0][0] == approx(least.min())
    assert_allclose(np.sort(counts["least_eigenvalues"]["classic"]), np.sort(least), rtol=1e-6)
    (drawn,) = ks.draw(counts).axes
    assert_allclose(drawn.lines[0].get_ydata(), np.sort(least), rtol=1e-6)
    assert counts["ours_least_eigenvalue"] > 0.0
    assert ks.search(5, 400, 0.6)[0][0] != q[0]


def test_reproduce_writes_picture_and_numbers(tmp_path):
    printed = done("reproduce kinematic_stability --seed 1 --out", tmp_path).stdout
    names = {f"kinematic_stability.{suffix}" for suffix in ("png", "svg", "pdf", "json")}
    assert names_in(tmp_path) == names
    assert (tmp_path / "kinematic_stability.pdf").read_bytes().startswith(b"%PDF")
    data = read_json(tmp_path / "kinematic_stability.json")
    assert data["postures"] == 1000 and data["seed"] == 1
    assert data["classic_unstable"] > 0 == data["ours_unstable"]
    assert str(data["classic_unstable"]) in printed


def test_eigenvalues_give_the_poles_of_the_closed_loop():
    """In the posture found, where the classic scheme is unstable, and in random ones."""
    q, _ = found()
    classic, ours = eigenvalues(q)
    assert classic.real.min() < 0.0 < poles(classic).real.max()
    assert poles(ours).real.max() < -1.0
    rng = default_rng(3)
    postures = [q]
    while len(postures) < 5:
        q = rng.uniform(-np.pi, np.pi, 6)
        postures += [q] if regularity(q) >= 1e-3 else []
    for q in postures:
        for values, oracle in aligned(eigenvalues(q), (oracle_classic, oracle_ours)):
            assert_same_poles(numeric_poles(oracle, q), poles(values))
