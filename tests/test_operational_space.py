"""Λ, μ, p, J, J̄, Φ, h of one arm against the textbook's formulas in extended precision."""

import pickle
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pinocchio as pin
from complaints import model_error
from numpy.linalg import cholesky, inv, svd
from numpy.random import default_rng
from numpy.testing import assert_array_equal
from pytest import fixture, mark, raises
from rigs import PANDA_Q, assert_near, largest, panda_arm, placed, refused, scara_pair, terms_at

import osc_contact as osc
from osc_contact import robots
from osc_contact.dynamics.closed_chain import RANK_TOLERANCE

BASE = placed(0.3, -0.2, 0.5, (0.4, -1.1, 2.0))
BALL = np.diag([1.0] * 3 + [0.1] * 3)  #: L of the inertia LLᵀ by which ranks are judged
STEP = 3e-3
CENTRAL = {1: 3 / 4, 2: -3 / 20, 3: 1 / 60}  #: sixth order


def ur5():
    urdf, _ = robots.find_robot("ur5")
    return osc.Arm.from_urdf(urdf, name="a", tip="tool0", base=BASE, armature=0.1)


ARMS = {"panda": lambda: panda_arm("a", BASE), "ur5": ur5, "scara": lambda: scara_pair().arms[0]}


@fixture(scope="module", params=ARMS)
def arm(request):
    return ARMS[request.param]()


def inverse(A):
    """Gauss and Jordan, in extended precision."""
    n = len(A)
    X = np.hstack((A, np.eye(n))).astype(np.longdouble)
    for k in range(n):
        X[k] /= X[k, k]
        others = np.arange(n) != k
        X[others] -= np.outer(X[others, k], X[k])
    return X[:, n:]


def jacobian(arm, q):
    data = arm.model.createData()
    frame = arm.model.getFrameId(arm.tip)
    J = pin.computeFrameJacobian(arm.model, data, q, frame, pin.LOCAL_WORLD_ALIGNED)
    return np.kron(np.eye(2), arm.base.rotation) @ J


def rank_of(chi, factor=1.0):
    """Directions in which inertia of arm and ball is less than 1/tolerance² times the least."""
    inertia = 1.0 + 1.0 / np.maximum(chi, 1e-30) ** 2
    return np.count_nonzero((factor * RANK_TOLERANCE) ** 2 * inertia < inertia[0])


def textbook(arm, q, v):
    """The terms, M and the least χ; J̇ by finite differences."""
    model = arm.model.copy()
    model.gravity.linear = arm.base.rotation.T @ model.gravity.linear
    data = terms_at(model, q, v)
    M = np.array(data.M)
    J = jacobian(arm, q)
    steps = {k: jacobian(arm, q + k * STEP * v) - jacobian(arm, q - k * STEP * v) for k in CENTRAL}
    drift = sum(CENTRAL[k] * d for k, d in steps.items()) @ v / STEP
    bar = inverse(M) @ J.T
    Phi = J @ bar
    chi = svd(BALL @ J @ inv(cholesky(M)).T)[1]
    terms = {"J": J, "Phi": Phi, "drift": drift, "h": np.array(data.nle)}
    if len(chi) == 6 and rank_of(chi, 1.1) == 6:
        Lambda = inverse(Phi)
        J_bar = bar @ Lambda
        mu = J_bar.T @ (data.nle - data.g) - Lambda @ drift
        terms |= {"Lambda": Lambda, "J_bar": J_bar, "p": J_bar.T @ data.g, "mu": mu}
    return (terms, M, chi)


def states(arm, count, seed=30):
    """Random ones, every second near the stretched posture: as near as 1e-5 rad."""
    rng = default_rng(seed)
    for k in range(count):
        size = 10.0 ** rng.uniform(-5.0, 0.0) if k % 2 else 1.0
        yield (size * rng.uniform(-2.5, 2.5, arm.model.nq), rng.standard_normal(arm.model.nv))


def test_they_are_the_textbooks_on_500_states(arm):
    least = np.inf
    for q, v in states(arm, 500):
        got = osc.operational_space(arm, q, v)
        expected, M, chi = textbook(arm, q, v)
        rank = rank_of(chi)
        for name, x in expected.items():  # χ of J is exact to 1e-16
            x = x.astype(float)
            atol = max(1e-10, 1e-14 / chi[-1]) * largest(x)
            assert_near(getattr(got, name), x, atol=atol, rtol=0, name=name)
        if rank_of(chi, 0.9) == rank_of(chi, 1.1):
            assert got.rank == rank
        if "Lambda" in expected:
            least = min(least, chi[-1])
        a = default_rng(1).standard_normal(arm.model.nv)
        F = got.Lambda @ (got.J @ a + got.drift) + got.mu + got.p
        if got.rank == 6:
            wrench = got.J_bar.T @ (M @ a + got.h)
            atol = max(1e-9, 1e-15 / chi[-1] ** 2) * largest(wrench)
            assert_near(F, wrench, atol=atol, rtol=0)
        elif got.rank == arm.model.nv:  # the structure carries the rest of F
            assert_near(got.J.T @ F, M @ a + got.h, atol=1e-6, rtol=0)
            R_S = BALL**2 @ got.J  # Λ = R S (SᵀR Φ R S)⁻¹ SᵀR with S = J
            half = R_S @ inverse(got.J.T @ R_S)
            Lambda = (half @ M @ half.T).astype(float)
            # rounding of M and J, which every BLAS kernel does in another order
            atol = max(1e-8, 3e-15 / chi[rank - 1] ** 2) * largest(Lambda)
            assert_near(got.Lambda, Lambda, atol=atol, rtol=0)
        P = got.J @ got.J_bar
        atol = max(1e-6, 1e-12 / chi[rank - 1] ** 2)
        assert_near(got.Phi @ got.Lambda, P, atol=atol, rtol=0)
        assert_near(P @ P, P, atol=atol, rtol=0)
    assert least < 5e-4 or arm.model.nv < 6, "near-singular states are among them"


def test_rows_threads_and_memory_given_change_nothing(arm):
    q, v = (np.array(x) for x in zip(*states(arm, 40, seed=3), strict=True))
    batch = osc.operational_space(arm, q.tolist(), v)
    again = pickle.loads(pickle.dumps(arm))
    kept = osc.operational_space(arm, q[0], v[0])
    assert osc.operational_space(arm, q, v, out=batch) is batch
    with ThreadPoolExecutor(4) as pool:
        others = list(pool.map(osc.operational_space, [arm, again] * 20, q, v))
    for k, other in enumerate(others):
        memory = kept.Lambda
        osc.operational_space(arm, np.repeat(q[k], 2)[::2], v[k], kept)
        assert np.shares_memory(memory, kept.Lambda)
        for name in osc.OperationalSpace.__annotations__:
            for one in (other, kept):
                assert_array_equal(getattr(batch, name)[k], getattr(one, name), err_msg=name)


@mark.parametrize(
    "q, v, words",
    [
        (PANDA_Q[:6], PANDA_Q, r"q: expected shape \(7\)"),
        ([PANDA_Q] * 2, PANDA_Q, "v: expected shape"),
        (np.ones((2, 3, 7)), PANDA_Q, "q: expected shape"),
        (PANDA_Q, [np.nan] * 7, r"v: element \(0,\) is nan"),
    ],
)
def test_bad_states_are_refused(q, v, words):
    arm = panda_arm("a", BASE)
    with refused(words):
        osc.operational_space(arm, q, v)
    out = osc.OperationalSpace(arm)
    other = panda_arm("b", BASE)
    with refused("another arm than 'b'"):
        osc.operational_space(other, PANDA_Q, PANDA_Q, out)
    with refused(r"q: expected shape \(7\), got \(2, 7\)"):
        osc.operational_space(arm, [PANDA_Q] * 2, [PANDA_Q] * 2, out)
    with raises(AttributeError, match="no attribute 'mass'"):
        _ = out.mass


def test_states_whose_inertia_is_not_positive_definite_are_refused():
    """The last link has a negative moment of inertia; the state of the first check shows none."""
    arm = panda_arm("a", BASE)
    link = arm.model.inertias[7].copy()
    link.inertia = link.inertia + np.diag([-0.045, 0.045, 0.045])
    arm.model.inertias[7] = link
    out = osc.OperationalSpace(arm)
    for q, result in ((PANDA_Q, out), ([PANDA_Q] * 2, None)):
        with model_error("the joint-space inertia of an arm is not positive definite"):
            osc.operational_space(arm, q, np.zeros_like(q), result)
