"""Internal forces of three or more arms, cut out at the grasps of a full system of equations."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
from grasp_rigs import random_case
from numpy.linalg import lstsq, norm, pinv, svd
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from pytest import fixture, mark
from rigs import contact_of, largest, random_faces, rig_of, unit
from test_decoupling import structured
from test_grasps import forces, moving

import osc_contact as osc
from osc_contact.response import require_reachable

LWA = pin.LOCAL_WORLD_ALIGNED


def bars_of(points):
    """E (3k, bars): unit bar forces on the object, pushing each pair of grasps together."""
    k = len(points)
    columns = []
    for i in range(k):
        for j in range(i + 1, k):
            f = np.zeros((k, 3))
            f[i] = unit(points[j] - points[i])
            f[j] = -f[i]
            columns.append(f.ravel())
    return np.array(columns).T


def cut(case, v, tau, qdd):
    """(k, 3) forces the arms exert at their tips, and these points, from each arm's own motion."""
    model = case.chain.model
    data = case.chain.model.createData()
    pin.computeAllTerms(model, data, case.q, v)
    pin.updateFramePlacements(model, data)
    out = []
    points = []
    balance = forces(case, tau) - data.nle - data.M @ qdd
    for arm, (kind, *_), s in zip(case.chain.arms, case.grasps, case.chain.slices, strict=True):
        f = model.getFrameId(f"{arm.name}/{arm.tip}")
        J = pin.getFrameJacobian(model, data, f, LWA)[:, s]
        J = J[:3] if kind == "ball" else J
        wrench, *_ = lstsq(J.T, balance[s], rcond=1e-10)
        assert_allclose(J.T @ wrench, balance[s], atol=1e-6)
        out.append(wrench[:3])
        points.append(data.oMf[f].translation.copy())
    return np.array(out), np.array(points)


def spans(A, tolerance, size=None):
    """Orthonormal columns: what A (m, n) spans, and what it takes to zero; `size` of its values."""
    U, s, Vh = svd(A)
    rank = np.count_nonzero(s > tolerance * (s.max(initial=0.0) if size is None else size))
    return U[:, :rank], Vh[rank:].T


def settable_bars(state, chain):
    """Levers (bars, n) of joint torques on bars, and the combinations (bars, s) that motors set.

    Left out are dependent bars, what the arms' structure carries, what no torques in null(G) make.
    """
    tolerance = chain.angle_tolerance
    root = np.sqrt(chain.reference.inertia.mass)
    with np.errstate(invalid="ignore"):
        E = np.nan_to_num(bars_of(state.grasp_points))  # no bar between grasps in one place
    share = np.split(pinv(E, rcond=tolerance), len(chain.arms), axis=1)
    levers = np.hstack(
        [own @ arm.J_bar[:, :3].T for own, arm in zip(share, state.arms, strict=True)]
    )
    carried = np.hstack(
        [own @ arm.C[:3] / root for own, arm in zip(share, state.arms, strict=True)]
    )
    basis = spans(E.T, tolerance)[0]
    basis = basis @ spans(carried.T @ basis, tolerance, 1.0)[1]
    known = np.isfinite(chain.tau_max)
    effort = np.where(known, chain.tau_max, chain.tau_max[known].max(initial=0.0) or 1.0)
    quiet = spans(state.G * effort, 1e-9)[1]
    U, size, Vh = svd(basis.T @ (levers[:, chain.actuated] * effort), full_matrices=False)
    some = size > 1e-9 * size.max(initial=0.0)
    # by the angle to null(G): an arm near a singular posture makes some forces all too easily
    apart = spans(Vh[some] @ quiet, tolerance, 1.0)[0]
    return levers, basis @ np.linalg.qr((U[:, some] * size[some]) @ apart)[0]


def cases(rng, count, arms, kinds):
    """Random states in contact: (case, state, contact, v, V)."""
    while count:
        case = random_case(
            [str(rng.choice(["ur5", "panda"])) for _ in range(arms)],
            [str(rng.choice(kinds)) for _ in range(arms)],
            rng,
        )
        pairs = random_faces(case.X_WO, 2, rng)
        try:
            state = case.chain.state(case.q, np.zeros(case.chain.nq), case.X_WO, np.zeros(6))
            require_reachable(state, contact_of(pairs, state))
        except osc.OscContactError:
            continue
        if state.unactuated.shape[1] or state.d < 6:  # an arm in a singular posture
            continue
        v, V, state, contact = moving(case, pairs, contact_of(pairs, state).N, rng)
        count -= 1
        yield case, state, contact, v, V


def answers(case, state, contact, v, V, commands, rng):
    """For each squeeze command: forces at the tips, points, acceleration, contact forces."""
    posture = case.q + 0.1 * rng.standard_normal(case.chain.nq)
    eta = rng.standard_normal(state.d)
    lever = state.S.T @ contact.N
    eta -= pinv(lever.T) @ (lever.T @ eta)
    want = contact.n_gamma - contact.N.T @ state.sigma
    eta += pinv(lever.T) @ want
    alpha = rng.uniform(5, 20, contact.r)
    f_S = state.Lambda_S @ eta + state.b_S + lever @ alpha
    for command in commands:
        tau = structured(case.chain, case.q, v, f_S, eta, command, posture, state)
        got = case.system(v, V).solve(forces(case, tau), contact.N, contact.n_gamma)
        f, points = cut(case, v, tau, got.qdd)
        yield f, points, got.a_object, got.alpha


@mark.parametrize("arms", [3, 4])
def test_each_bar_carries_its_command_and_nothing_else_feels_it(arms):
    """The forces cut at the grasps, projected on the bars; then the motion-inducing rest."""
    rng = default_rng(70)
    count = arms * (arms - 1) // 2
    for case, *state in cases(rng, 4, arms, ["rigid", "rigid", "ball"]):
        one, two = rng.standard_normal((2, count)) * 20.0
        commands = (one, two, 7.5, 0.0)
        seen = list(answers(case, *state, commands, rng))
        points = seen[0][1]
        E = bars_of(points)
        for command, (f, *_) in zip(commands[:3], seen, strict=False):
            t = lstsq(E, f.ravel(), rcond=1e-12)[0]
            assert_allclose(t, command * np.ones(count), atol=1e-7 * 20.0)
        for f, _, a, alpha in seen[1:]:
            size = largest(seen[0][2])
            assert_allclose(a, seen[0][2], atol=1e-9 * max(size, 1.0))
            assert_allclose(alpha, seen[0][3], atol=1e-9 * largest(alpha))
            change = f - seen[0][0]
            assert_allclose(change.sum(axis=0), 0.0, atol=1e-7)


def test_dependent_bars_share_and_the_object_does_not_notice():
    """Five arms: ten bars, nine independent; what comes is the nearest to what was wanted."""
    rng = default_rng(72)
    for case, *state in cases(rng, 2, 5, ["rigid", "ball"]):
        wanted = rng.standard_normal(10) * 20.0
        one, other = answers(case, *state, (wanted, 0.0), rng)
        (f, points, a, alpha) = one
        (_, _, b, beta) = other
        E = bars_of(points)
        assert_allclose(pinv(E) @ f.ravel(), pinv(E) @ (E @ wanted), atol=1e-6)
        assert_allclose(a, b, atol=1e-9 * max(largest(a), 1.0))
        assert_allclose(alpha, beta, atol=1e-9 * largest(beta))


@fixture(scope="module")
def plate():
    """With gains for one mass."""
    gains = "gains={force: {integral: 10, damping: 3000}}"
    return rig_of("three_arm_plate", gains)


def test_commands_by_number_and_by_bar(plate):
    """0 leaves least effort; any other number is meant for every bar."""
    measurement = plate.plant().measure()
    reference = plate.references.at(0.0)
    fast = plate.controller()
    for squeeze in (0.0, 12.0, np.array([5.0, -3.0, 8.0]), np.zeros(3)):
        wanted = replace(reference, squeeze_d=squeeze)
        got = fast.tick(measurement, wanted)
        assert fast.status is osc.Status.OK, fast.reason
        if np.ndim(squeeze) == 0 and squeeze == 0.0:
            least = norm(got / plate.chain.tau_max)
        assert norm(got / plate.chain.tau_max) >= least
        found = fast.result().squeeze
        assert_allclose(found, squeeze * np.ones(3), atol=1e-8, rtol=0)
    by_bar = osc.pose_reference([0, 0, 0], squeeze_d=np.array([5.0, -3.0, 8.0])).squeeze_d
    assert_array_equal(by_bar, [5.0, -3.0, 8.0])
    pair = rig_of("two_contact_rod")
    two = pair.controller()
    wanted = replace(pair.references.at(0.0), squeeze_d=np.array([5.0, 5.0]))
    two.tick(pair.plant().measure(), wanted)
    assert two.status is osc.Status.HELD and "2 arms take a number" in two.reason
    for bad in (np.zeros(2), np.array([1.0, np.nan, 0.0]), np.zeros((3, 1)), "5 N", np.nan, [1, 2]):
        held = fast.tick(measurement, replace(reference, squeeze_d=bad))
        assert fast.status is osc.Status.HELD and "squeeze_d" in fast.reason
        assert np.isfinite(held).all()


def test_motor_limits_take_it_first(plate):
    """4 kN cannot be had: torques within limits, forces and motion hardly touched, told by bar."""
    measurement = plate.plant().measure()
    reference = plate.references.at(0.0)
    controller = plate.controller()
    controller.tick(measurement, reference)
    squeeze = np.array([4000.0, 100.0, 50.0])
    tau = controller.tick(measurement, replace(reference, squeeze_d=squeeze))
    assert controller.status is osc.Status.SATURATED
    assert (np.abs(tau) <= plate.chain.tau_max).all()
    lost = controller.given_up
    assert lost.squeeze.shape == (3,) and lost.squeeze[0] > 1000.0
    assert largest(lost.acceleration) < 0.1 and largest(lost.force) < 1.0
    assert_allclose(controller.result().squeeze, squeeze - lost.squeeze, rtol=1e-9)


def test_a_squeezed_plate_stays_within_its_limits():
    """On MuJoCo: 10 N in every side of the triangle while three contact forces are controlled."""
    scenario = osc.load_scenario("three_arm_plate", ["squeeze=10 N"])
    recording = osc.run(scenario, duration=1.5)
    verdict = osc.metrics(recording)
    for name, force in verdict["force"].items():
        assert force["rms_error_rel"] <= 0.01, name
    assert recording["squeeze"].shape == (len(recording), 3)
    assert_allclose(recording["squeeze"], 10.0, atol=1e-6)
    # at first the gaps are zero up to rounding, and the forces rise from zero
    assert recording["closed"][10:].all()
