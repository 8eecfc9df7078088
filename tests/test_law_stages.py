"""Small functions of the law, each against linear algebra or Pinocchio: forces, stops, stages.

What whole ticks show (the motion filter, commanded forces, yielding bodies) `test_law_kkt` judges.

Goes on where `test_law_parts.py` ends, in the same way.
"""

from math import inf
from types import SimpleNamespace as Record

import numpy as np
import pinocchio as pin
from law_calls import allocation, operational, phases, reading, safety, tick, tick_of, vectors
from law_calls import command_filter as command
from numpy.testing import assert_array_equal
from pytest import mark
from rigs import random_faces, random_state, scara_pair
from test_law import UNLIMITED, inputs, motion_of
from test_law_parts import SEEDS, close, pose, rng_of, turn

import osc_contact as osc
from osc_contact.law import records as at
from osc_contact.law.limits import TorqueLimits, settle
from osc_contact.law.phases import APPROACHING, CLOSED, OPEN
from osc_contact.law.records import Rows, new_model, views
from osc_contact.law.tick import MOVING


def wrench_at(p):
    """A wrench at p, to the world's origin; its transpose carries motions the other way."""
    return pin.SE3(np.eye(3), np.array(p)).toDualActionMatrix()


class Energy:
    """Energy coordinates of an object of 2 kg at C, given at O."""

    def __init__(self, rng):
        self.R = turn(rng)
        self.C = rng.normal(size=3)
        self.O = rng.normal(size=3)
        self.roots = np.sqrt([2.0, 0.03, 0.05, 0.07])
        self.axes = np.zeros((4, 3, 3))
        vectors.set_axes(self.R, self.roots, self.axes)
        L = np.diag(np.repeat(self.roots, [3, 1, 1, 1])) @ np.kron(np.eye(2), self.R.T)
        self.wrench = np.linalg.inv(L.T) @ wrench_at(self.O - self.C)  # of one at O
        self.motion = np.linalg.inv(self.wrench).T

    def given(self):
        return {"C": self.C, "O": self.O, "axes": self.axes}


# --- forces ---------------------------------------------------------------------------------------


def frame(M):
    """(12,): rotation by rows, then point."""
    return np.append(M.rotation.ravel(), M.translation)


@SEEDS
def test_readings_of_the_wrists_add_up(seed):
    rng = rng_of(seed)
    e = Energy(rng)
    arms = []
    joints = []
    total = np.zeros(6)
    wrenches = rng.normal(size=(3, 6))
    tare = rng.normal(size=6)
    bias = rng.normal(size=6)
    for k in range(3):
        M = pose(rng)
        sensor = pose(rng)
        joints.append(Record(R=M.rotation, p=M.translation))
        arms.append(Record(sensor_joint=-1 if k == 1 else k, sensor=frame(sensor), filtered=0))
        if k != 1:
            at_O = pin.SE3(np.eye(3), e.O).inverse() * M * sensor
            total += at_O.act(pin.Force(wrenches[k])).vector
    work = Record(
        **e.given(),
        reading_e=np.ones(6),
        f_meas=np.ones(6),
        y=np.zeros(6),
        s=np.zeros(16),
        u=np.zeros(6),
        bias_e=bias,
    )
    reading.sum_readings(
        tick_of(
            model=Record(n_arms=3),
            model_arms=arms,
            work_arms=[None] * 3,
            work_joints=joints,
            work=work,
            input_wrenches=wrenches,
            memory=Record(f_tare=tare),
        )
    )
    close(work.f_meas, total - tare, atol=1e-10)
    close(work.reading_e, e.wrench @ (total - tare) - bias, atol=1e-9)


@mark.parametrize("dependent", [False, True])
def test_friction_goes_with_the_magnitudes(dependent):
    rng = rng_of(int(dependent))
    e = Energy(rng)
    chosen = [2, 0, 3]
    N = rng.normal(size=(6, 6))
    r = 2 if dependent else 3
    columns = [
        Record(chosen=c, share=rng.normal(size=6), friction_wrench=rng.normal(size=6))
        for c in (*chosen, 1)
    ]
    S = np.array([columns[j].share[:r] for j in range(3)]) if dependent else np.eye(3)
    D = S.T @ np.array([columns[c].friction_wrench for c in chosen])
    for mu in (0.0, 0.4):
        work = Record(
            **e.given(),
            rank=r,
            count=3,
            mu=mu,
            N=N,
            u=np.zeros(6),
            pushed=np.ones((6, 6)),
            friction_wrenches=np.ones((6, 6)),
        )
        reading.add_friction(tick_of(work_columns=columns, work=work))
        close(work.friction_wrenches[:r], (mu > 0.0) * D, atol=1e-10)
        close(work.pushed[:r], N[:r] + (mu > 0.0) * D @ e.wrench.T, atol=1e-9)


class Filter:
    """Columns of N in energy coordinates and what the arms' outboard parts make of them."""

    def __init__(self, seed, r, m=0, held=1):
        rng = rng_of(seed)
        self.chain = Record(held=held)
        self.r = r
        self.m = m
        self.N = rng.normal(size=(r, 6))
        Q, R = np.linalg.qr(self.N.T)
        self.Lambda = np.eye(6) * 3.0 + rng.normal(size=(6, 6))  # not symmetric: grasps that slip
        V = rng.normal(size=(6, 6))
        H = np.eye(6)
        for k in range(m):
            H = (np.eye(6) - 2.0 / (V[k] @ V[k]) * np.outer(V[k], V[k])) @ H
        self.H = H
        turned = np.where(np.arange(6) < m, rng.normal(size=6), 0.0)
        self.sigma = H.T @ turned
        self.S = H.T[:, m:]
        self.f = rng.normal(size=6)
        self.Phi = 0.2 * rng.normal(size=(r, r))
        self.pushed = self.N + 0.2 * rng.normal(size=(r, 6))
        self.known = rng.normal(size=(2, r))
        self.work = Record(
            rank=r,
            locked=m,
            weightless=9,
            reflectors=V,
            beta=2.0 / (V * V).sum(axis=1),
            sigma=turned,
            Q=rng.normal(size=(6, 6)),
            L=rng.normal(size=(6, 6)),
            out_T=self.Lambda.T.copy(),
            reading_e=self.f.copy(),
            Phi_mu=np.zeros((6, 6)),
            pushed=rng.normal(size=(6, 6)),
            n_gamma=self.known[0],
            b_N=self.known[1],
            alpha_meas=np.full(6, 7.0),
            **{name: rng.normal(size=(6, 6)) for name in ("A", "B", "D", "E", "solved")},
            mobility=np.zeros((6, 6)),
            z=np.ones(6),
            w=np.ones(6),
            u=np.ones(6),
        )
        self.work.Q[:r] = Q.T
        self.work.L[:r, :r] = R.T
        self.work.pushed[:r] = self.pushed
        self.work.Phi_mu[:r, :r] = self.Phi

    def measure(self):
        assert reading.measure_magnitudes(tick_of(model=self.chain, work=self.work))
        assert self.work.alpha_meas[self.r :].tolist() == [7.0] * (6 - self.r)
        return self.work.alpha_meas[: self.r]

    def want(self):
        """Sᵀf = SᵀΛ_out(Sη̇ + σ) + SᵀN_μα, Nᵀ(Sη̇ + σ) = n_γ + b_N + Φ_μα."""
        S = self.S
        Lambda = self.Lambda
        d = 6 - self.m
        whole = np.block([[S.T @ Lambda @ S, S.T @ self.pushed.T], [self.N @ S, -self.Phi]])
        right = np.append(
            S.T @ (self.f - Lambda @ self.sigma), self.known.sum(axis=0) - self.N @ self.sigma
        )
        mobility = self.N @ S @ np.linalg.solve(S.T @ Lambda @ S, S.T @ self.pushed.T) + self.Phi
        return np.linalg.solve(whole, right)[d:], mobility


@mark.parametrize("r", range(1, 7))
def test_magnitudes_with_what_the_object_takes(r):
    case = Filter(r, r)
    alpha, mobility = case.want()
    close(case.measure(), alpha, atol=1e-7)
    close(case.work.mobility[:r, :r], mobility, atol=1e-8)
    assert case.work.weightless == 0
    case.work.out_T[:, 2] = case.work.out_T[:, 4]
    assert not reading.measure_magnitudes(tick_of(model=case.chain, work=case.work))
    case = Filter(r, r)
    case.work.pushed[:r] = case.work.Phi_mu[:r, :r] = 0.0  # nobody pushes and nobody yields
    assert not reading.measure_magnitudes(tick_of(model=case.chain, work=case.work))


@mark.parametrize(("r", "m"), [(1, 0), (3, 0), (2, 1), (1, 3), (2, 3), (3, 2), (1, 5)])
def test_magnitudes_at_a_tip_that_has_inertia(r, m):
    case = Filter(10 * r + m, r, m, held=0)
    alpha, mobility = case.want()
    close(case.measure(), alpha, rtol=1e-6, atol=1e-7)
    close(case.work.mobility[:r, :r], mobility, rtol=1e-6, atol=1e-8)
    close(case.work.pushed[:r], case.pushed, atol=1e-12)
    assert case.work.weightless == 0
    if m < 5:
        case = Filter(10 * r + m, r, m, held=0)
        P = case.S @ case.S.T  # of no inertia along one of the tip's motions
        P -= np.outer(case.S[:, 0], case.S[:, 0])
        case.work.out_T = (case.Lambda @ P).T
        assert not reading.measure_magnitudes(tick_of(model=case.chain, work=case.work))


@mark.parametrize("r", [1, 3, 6])
def test_sensors_at_the_contact_read_the_contact_force(r):
    case = Filter(r, r, held=0)
    case.work.out_T *= 1e-11
    # N_μα = f along the directions that N spans
    Q = np.linalg.qr(case.N.T)[0].T
    close(case.measure(), np.linalg.solve(Q @ case.pushed.T, Q @ case.f), rtol=1e-7)
    close(case.work.mobility[:r, :r], case.N @ case.pushed.T, atol=1e-9)
    assert case.work.weightless == 1


def ask_force(alpha_d, alpha_meas, speed, integral, least=-inf, gain=20.0, damping=100.0, most=5.0):
    after = np.zeros(3)
    out = np.zeros(3)
    # columns beside it differ, so that each has its own
    full = [
        np.array([1.0, x, 2.0])
        for x in (alpha_d, alpha_meas, speed, integral, gain, damping, least)
    ]
    a_d, a_m, s, i, g, d, floor = full
    reading.command_force(
        tick_of(
            work=Record(
                rank=2,
                alpha_d=a_d,
                felt=a_m,
                speed=s,
                w=i,
                gain=g,
                damping=d,
                least=floor,
                dt=1e-3,
                force_next=after,
                alpha_u=out,
            ),
            model=Record(integral_force=most),
        )
    )
    assert after[2] == out[2] == 0.0 and after[0] == 1.0
    return out[1], after[1]


def test_the_force_law():
    close(ask_force(8.0, 6.0, 0.01, 0.5), (8.0 + 0.5 + 0.04 - 1.0, 0.54), rtol=1e-12)
    close(ask_force(8.0, 6.0, -0.01, 0.5), (8.0 + 0.5 + 0.04 + 1.0, 0.54), rtol=1e-12)
    # the integral stays within 5 N or one and a half times the command
    close(ask_force(1.0, 0.0, 0.0, 5.0), (6.0, 5.0), rtol=1e-12)
    close(ask_force(8.0, -990.0, 0.0, 0.0), (20.0, 12.0), rtol=1e-12)
    close(ask_force(-8.0, 990.0, 0.0, 0.0), (-20.0, -12.0), rtol=1e-12)
    close(ask_force(1.0, 900.0, 0.0, 0.0), (-4.0, -5.0), rtol=1e-12)
    assert reading.integral_room(5.0, -8.0) == 12.0
    assert reading.integral_room(5.0, 3.0) == 5.0
    # no less than α_min, or a tenth of the command; the integral does not go on then
    close(ask_force(8.0, 9.0, 0.1, -1.0, 0.5), (0.5, -1.0), rtol=1e-12)
    close(ask_force(8.0, 7.0, 0.1, -1.0, 0.5), (0.5, -0.98), rtol=1e-12)
    close(ask_force(2.0, 7.0, 0.1, -1.0, 0.5), (0.2, -1.0), rtol=1e-12)
    close(ask_force(8.0, 9.0, 0.06, -1.0, 0.5), (0.98, -1.02), rtol=1e-12)


@mark.parametrize("dependent", [False, True])
def test_laws_of_contacts_are_those_of_their_columns(dependent):
    contacts = [
        Record(gain=3.0, damping=5.0, least=0.1, brake=0.7),
        Record(gain=2.0, damping=9.0, least=0.2, brake=0.6),
        Record(gain=1.0, damping=4.0, least=0.3, brake=0.8),
        Record(gain=0.0, damping=99.0, least=0.9, brake=9.0),
    ]
    table = [Record(contact=c) for c in (1, 0, 2, 3)]
    columns = [Record(chosen=c) for c in (2, 0, 1)]
    laws = {name: np.full(3, 7.0) for name in ("gain", "damping", "brake", "least")}
    work = Record(rank=2, count=3 if dependent else 2, keep=[1.0, 0.0], **laws)
    reading.contact_laws(
        tick_of(model_columns=table, memory_contacts=contacts, work_columns=columns, work=work)
    )
    found = np.array([work.gain, work.damping, work.least, work.brake])
    want = [[1.0, 1.0], [9.0, 9.0], [-inf, -inf], [0.8, 0.8]]
    if not dependent:
        want = [[2.0, 1.0], [9.0, 4.0], [0.2, 0.3], [0.6, 0.8]]
    assert_array_equal(found, np.column_stack((want, np.full(4, 7.0))))


# --- stops ----------------------------------------------------------------------------------------


class Stop:
    """Two arms of two joints that hold an object of 4 kg."""

    def __init__(self, seed, motors=(0, 1, 2, 3)):
        self.rng = rng = rng_of(seed)
        self.principal = np.array([4.0, 0.1, 0.2, 0.3])
        self.tip = pose(rng)
        self.own = pose(rng)
        self.chain = Record(
            n_arms=2,
            principal=self.principal,
            leader=1,
            held=1,
            gravity=np.array([1.0, -2.0, -9.0]),
            X_LP=frame(self.own),
        )
        self.arms = [Record(first=2 * k, end=2 * k + 2, tip_joint=2 * k + 1) for k in range(2)]
        self.joints = [
            Record(
                h=rng.normal(),
                M=rng.normal(size=2),
                column=rng.normal(size=6),
                tau=0.0,
                acceleration=rng.normal(),
                rest=0.0,
            )
            for _ in range(4)
        ]
        self.joints[3].R = self.tip.rotation
        self.joints[3].p = self.tip.translation
        self.table = [Record(motor=i, tau_max=inf) for i in motors]
        self.memory = Record(located=0, X_WO=pose(rng).homogeneous)
        self.work = Record(
            y=rng.normal(size=6), u=rng.normal(size=6), A=np.eye(6), z=np.ones(6), w=np.zeros(6)
        )
        self.work.A[:3, :3] = turn(rng)

    def pull(self, mass):
        """The wrench at the world's origin, by Pinocchio."""
        a = sum(j.column * j.acceleration for j in self.joints[2:])
        R = self.work.A[:3, :3]
        share = pin.Inertia(mass, self.work.u[:3], R @ np.diag(self.principal[1:] / 2.0) @ R.T)
        return (share * pin.Motion(a)).vector if mass else np.zeros(6)


@SEEDS
def test_a_share_of_the_object_follows_the_joints(seed):
    stop = Stop(seed)
    out = np.full(6, 7.0)
    for mass in (2.0, 0.0):
        safety._accelerate_object(
            tick_of(model=stop.chain, work_joints=stop.joints, work=stop.work),
            stop.arms[1],
            mass,
            out,
        )
        close(out, stop.pull(mass), atol=1e-10)


@SEEDS
@mark.parametrize("motors", [(0, 1, 2, 3), (0, 1, -1, 2), (0, 1, 2, -1), (0, 1, -1, -1)])
def test_motors_carry_first_and_brake_with_what_is_left(seed, motors):
    stop = Stop(seed, motors)
    pull = stop.pull(2.0)
    carry = np.array([j.h + j.column @ stop.work.y for j in stop.joints[2:]])
    q_dd = np.array([j.acceleration for j in stop.joints[2:]])
    brake = np.array([j.M @ q_dd + j.column @ pull for j in stop.joints[2:]])
    # room of both signs, none, less than 1 N m, and less than the arm needs to be carried
    for room in (2.0, 0.9, 0.5, 0.3, 0.05, 0.0, -0.4):
        for j in range(2):
            stop.table[2 + j].tau_max = carry[j] * np.sign(brake[j]) + room * abs(brake[j])
            other = stop.table[3 - j]
            other.tau_max = abs(carry[1 - j]) + 5.0 * abs(brake[1 - j])
            share = safety._split_torques(
                tick_of(
                    model=stop.chain,
                    model_joints=stop.table,
                    work_joints=stop.joints,
                    work=stop.work,
                ),
                stop.arms[1],
                2.0,
            )
            want = min(max(room, 0.1), 1.0) if motors[2 + j] >= 0 else 1.0
            close(share, want, rtol=1e-9)
            close([j.tau for j in stop.joints[2:]], carry, atol=1e-12)
            sent = share * np.array([j.rest for j in stop.joints[2:]])
            driven = np.array(motors[2:]) >= 0
            least = brake * [min(max(room, 0.0), 1.0) if k == j else 1.0 for k in range(2)]
            powers = [(torques @ (driven * q_dd)) for torques in (share * brake, least)]
            close(
                sent[driven], (least if powers[1] > powers[0] else share * brake)[driven], atol=1e-9
            )
    for j in stop.joints:
        j.acceleration = 0.0
    assert (
        safety._split_torques(
            tick_of(
                model=stop.chain, model_joints=stop.table, work_joints=stop.joints, work=stop.work
            ),
            stop.arms[1],
            0.0,
        )
        == 1.0
    )


@SEEDS
@mark.parametrize("how", ["leader", "located", "lost", "nothing"])
def test_each_arm_carries_its_share_of_the_weight(seed, how):
    stop = Stop(seed)
    X = stop.tip * stop.own
    if how != "leader":
        stop.chain.leader = -1
        X = pin.SE3(stop.memory.X_WO) * stop.own
    stop.memory.located = int(how == "located")
    stop.chain.held = int(how != "nothing")
    mass = safety._carry_weight(
        tick_of(
            model=stop.chain,
            model_arms=stop.arms,
            memory=stop.memory,
            work_joints=stop.joints,
            work=stop.work,
        )
    )
    if how in ("lost", "nothing"):
        assert mass == 0.0 and not stop.work.y.any() and not stop.work.u[:3].any()
        return
    assert mass == 2.0
    close(stop.work.u[:3], X.translation, atol=1e-12)
    close(stop.work.A[:3, :3], X.rotation, atol=1e-12)
    weight = np.append(-2.0 * stop.chain.gravity, np.zeros(3))
    close(stop.work.y, wrench_at(X.translation) @ weight, atol=1e-11)


# --- singular postures ----------------------------------------------------------------------------


@SEEDS
def test_a_posture_may_be_singular_where_its_inertia_beside_the_reference_is_large(seed):
    rng = rng_of(seed)
    root = rng.normal(size=(6, 6))
    reference = 10.0 ** rng.uniform(-2.0, 1.0, 6)
    Lambda = root @ root.T
    beside = np.sqrt((Lambda**2 / np.outer(reference, reference)).sum())
    Lambda *= 0.3**-2 / beside  # at the limit: 1/χ² = 1/0.3²
    chain = Record(lightness=1.0 / reference)
    arm = Record(full_rank=5)
    for factor, kept, want in ((0.999, 5, False), (1.001, 5, True), (1e-9, 4, True)):
        own = Record(Lambda=factor * Lambda, n_kept=kept)
        assert operational.may_be_singular(tick_of(model=chain), arm, own) == want


@mark.parametrize("chi", [0.0, 1e-10])
@mark.parametrize("n", [2, 4, 7])
def test_a_motion_that_does_nothing_is_any_that_is_new(n, chi):
    """The axes before it are spanned already: only the last ones are new."""
    rng = rng_of(n)
    small = operational._unit_row
    for k in range(n):
        X = np.zeros((n + 1, n + 2))
        X[:k, :k] = np.linalg.qr(rng.normal(size=(k, k)))[0]
        if k == n - 1 and n > 2:
            X[:k, :n] = np.linalg.qr(rng.normal(size=(n, n)))[0][:k]
        X[k] = chi * rng.normal(size=n + 2)
        behind = X[k, n:].copy()
        small(X, k, n, chi)
        close(X[: k + 1, :n] @ X[: k + 1, :n].T, np.eye(k + 1), atol=1e-12)
        assert_array_equal(X[k, n:], behind)
    X = rng.normal(size=(3, 7))
    want = X[1, :5] / 0.3
    small(X, 1, 5, 0.3)
    close(X[1, :5], want, rtol=1e-12)


def test_rows_in_order_shares_and_the_way_back():
    rng = rng_of(0)
    X = rng.normal(size=(5, 3 + 6 + 1)) * np.array([0.1, 5.0, 0.01, 2.0, 9.0])[:, None]
    X[1, 3:] *= 1e-6  # what stands behind does not count
    before = X.copy()
    operational._sort_rows(X, 4, 3)
    order = [*np.argsort(-np.linalg.norm(before[:4, :3], axis=1)), 4]
    assert_array_equal(X[:, :9], before[order, :9])
    assert_array_equal(X[:, 9], before[:, 9])
    share = operational._share_left
    for s, want in ((-1.0, 0.0), (0.0, 0.0), (0.25, 0.15625), (0.5, 0.5), (1.0, 1.0), (9.0, 1.0)):
        close(share(0.05 + 0.25 * s), want, atol=1e-12)
    chain = Record(posture_stiffness=3.0, retreat_damping=7.0)
    close(operational.retreat(tick_of(model=chain), Record(posture=0.5), 0.2, 0.1), 0.9 - 0.7)


@SEEDS
@mark.parametrize("gone", [0.0, 1.0])
def test_lost_motions_are_left_to_the_posture(seed, gone):
    """νᵀτ = (1 − φ) νᵀ(h + M q̈) for ν with νᵀMν = 1; where it is gone, all of it."""
    rng = rng_of(seed)
    n = 3
    lo = 2
    root = rng.normal(size=(n, n))
    M, h, tau, rest = root @ root.T, *rng.normal(size=(3, n))
    q, v, posture = rng.normal(size=(3, lo + n))
    modes = np.linalg.inv(np.linalg.cholesky(M)).T[:, :2].T
    joints = [None] * lo + [Record(M=M[j], h=h[j], tau=tau[j], rest=rest[j]) for j in range(n)]
    own = Record(n_lost=2, mode=modes, gone=[gone, gone], share=[0.3, 0.8])
    allocation._retreat_from_lost(
        tick_of(
            model=Record(posture_stiffness=3.0, retreat_damping=7.0),
            model_joints=[Record(posture=p) for p in posture],
            work_joints=joints,
            input_q=q,
            input_v=v,
        ),
        Record(first=lo, end=lo + n),
        own,
    )
    back = h + M @ (3.0 * (posture - q) - 7.0 * v)[lo:]
    want = rest.copy()
    for mode, share in zip(modes, own.share, strict=True):
        want += mode @ (back - tau if gone else (1.0 - share) * back) * (M @ mode)
    close([j.rest for j in joints[lo:]], want, rtol=1e-9, atol=1e-9)


# --- torques --------------------------------------------------------------------------------------


def test_torques_are_given_unless_one_is_beyond_its_limit_or_no_number():
    table = [Record(motor=i, tau_max=2.0) for i in (1, -1, 0)]
    for torques, excess, finite in (
        ((1.9, 99.0, -2.0), False, True),
        ((2.1, 0.0, 0.0), True, True),
        ((0.0, 0.0, -2.1), True, True),
        ((np.nan, 0.0, 0.0), False, False),
        ((0.0, 0.0, -inf), False, False),
        ((0.0, np.nan, 0.0), False, True),
    ):
        tau = np.full(4, 7.0)
        joints = [Record(tau=t) for t in torques]
        found = allocation.limit_torques(
            tick_of(model=Record(n_joints=3), model_joints=table, work_joints=joints, work_tau=tau)
        )
        assert found == (excess, finite)
        given = finite and not excess
        assert tau.tolist() == ([torques[2], torques[0], 7.0, 7.0] if given else [7.0] * 4)


def test_joints_are_pushed_away_from_their_limits():
    joint = Record(low=-1.0, high=2.0, width=0.4, most=6.0)
    push = allocation.push_from_limits
    for q, want in (
        (0.0, 0.0),
        (2.0, 0.0),
        (2.1, -6.0 * 0.15625),
        (2.2, -3.0),
        (2.4, -6.0),
        (3.0, -6.0),
        (-1.0, 0.0),
        (-1.1, 6.0 * 0.15625),
        (-1.4, 6.0),
        (-9.0, 6.0),
    ):
        close(push(joint, q), want, atol=1e-12)


# --- columns of N in the turned coordinates -------------------------------------------------------


def judged(N, Lambda, held, m=0):
    """The reason of `require_reachable`, which column, and what is left."""
    scratch = {name: np.full((6, 6), 7.0) for name in ("Q_t", "L_t", "A", "B", "D", "E")}
    rows = np.full((6, 6), 7.0)
    rows[: len(N)] = N
    work = Record(rank=len(N), locked=m, N_t=rows, Lambda=Lambda, where=-1, amount=-1.0, **scratch)
    return command.require_reachable(tick_of(model=Record(held=held), work=work)), work


@mark.parametrize("held", [0, 1])
def test_columns_on_which_the_arms_can_push(held):
    rng = rng_of(held)
    root = rng.normal(size=(6, 6))
    Lambda = root @ root.T + np.eye(6)
    assert judged(np.zeros((0, 6)), Lambda, held)[0] == at.NO_REASON
    for m in (0, 2, 5):
        N = rng.normal(size=(min(3, 6 - m), 6))
        assert judged(N, Lambda, held, m)[0] == at.NO_REASON
        for a in range(len(N)):
            hidden = N.copy()
            hidden[a, m:] *= 1e-9
            reason, work = judged(hidden, Lambda, held, m)
            if m:
                assert (reason, work.where) == (at.UNREACHABLE, a)
    assert judged(N, Lambda, held, 6)[0] == at.UNREACHABLE
    # 1/Λ along the column, beside 1: on either side of 1e-9
    for mobility, want in ((0.5e-9, at.UNREACHABLE), (2e-9, at.NO_REASON)):
        heavy = np.eye(6) / 7.0
        heavy[3, 3] = 1.0 / mobility
        reason, work = judged(np.eye(6)[[1, 3]], heavy, held)
        assert reason == want and (want == at.NO_REASON or work.where == 1)
    # columns that differ by so much
    for apart, want in ((0.3e-10, at.INSEPARABLE), (3e-10, at.NO_REASON)):
        N = np.zeros((2, 6))
        N[:, 1] = 1.0
        N[1, 4] = apart
        assert judged(N, np.eye(6), held)[0] == want


@mark.parametrize("held", [0, 1])
@mark.parametrize("m", [0, 2])
def test_how_far_columns_are_apart_as_seen_through_the_arms(held, m):
    rng = rng_of(m)
    d = 6 - m
    root = rng.normal(size=(6, 6))
    N = rng.normal(size=(3, 6))
    Lambda = root @ root.T
    _, work = judged(N, Lambda, held, m)
    assert command._judge_reach(tick_of(model=Record(held=held), work=work)) == at.NO_REASON
    L = np.linalg.cholesky((Lambda + held * np.eye(6))[m:, m:])
    seen = np.linalg.solve(L, N[:, m:].T)
    pivots = np.abs(np.diag(np.linalg.qr(seen)[1]))
    close(work.amount, min(pivots / np.linalg.norm(seen, axis=0)), rtol=1e-7)
    N[1, m:] = L @ np.full(d, 0.5e-5)  # seen with 0.25e-10 d of its square
    if m:
        reason, work = judged(N, Lambda, held, m)
        assert (reason, work.where) == (at.UNREACHABLE, 1)
        close(work.amount, d * 0.25e-10 / (N[1] @ N[1]), rtol=1e-6)


def test_an_inertia_that_is_none_is_noticed_where_nothing_is_held():
    Lambda = np.diag([1.0, 1.0, 1.0, 1.0, 0.0, 1.0])
    assert judged(np.eye(6)[:2], Lambda, 0)[0] == at.BAD_METRIC
    assert judged(np.eye(6)[:2], Lambda, 1)[0] == at.NO_REASON


# --- stages ---------------------------------------------------------------------------------------


def test_every_number_that_comes_in_is_looked_at():
    chain = Record(n_joints=2, n_arms=2, n_columns=3, n_bars=2, n_contacts=2)
    shapes = {
        "q": (3,),
        "v": (3,),
        "wrenches": (3, 6),
        "X_WD": (4, 4),
        "V_D": (6,),
        "A_D": (6,),
        "alpha_d": (4,),
        "squeeze": (3,),
        "touched": (3, 28),
    }
    counts = {
        "q": 2,
        "v": 2,
        "wrenches": 12,
        "X_WD": 16,
        "V_D": 6,
        "A_D": 6,
        "alpha_d": 3,
        "squeeze": 2,
        "touched": 56,
    }
    given = {name: np.ones(shape) for name, shape in shapes.items()}

    def look(chain, squeeze, engaged, moving, **came):
        return tick.is_finite(
            tick_of(model=chain, memory=Record(squeeze=squeeze), input=Record(**came)),
            engaged,
            moving,
        )

    for engaged in (False, True):
        for moving in (False, True):
            assert look(chain, engaged=engaged, moving=moving, **given)
    for name, x in given.items():
        for i in range(x.size):
            for bad in (np.nan, inf, -inf):
                x.flat[i] = bad
                for on in (False, True):
                    asked = {"alpha_d": on, "touched": on}.get(name, True)
                    with np.errstate(invalid="ignore"):
                        fine = look(chain, engaged=on, moving=on, **given)
                    assert fine == (not asked or i >= counts[name]), (name, i)
                x.flat[i] = 1.0
    given["squeeze"][0] = np.nan  # without bars one number is looked at
    none = Record(**vars(chain) | {"n_bars": 0})
    assert not look(none, engaged=True, moving=True, **given)


def test_friction_that_is_learnt_is_never_negative():
    e = Energy(rng_of(0))
    work = Record(
        **e.given(),
        count=0,
        rank=0,
        locked=0,
        moving=0,
        f_c=np.ones(6),
        f_meas=np.ones(6),
        reading_e=np.ones(6),
        y=np.ones(6),
        u=np.ones(6),
        bias_e=np.zeros(6),
    )
    for more, want in ((0.1, 0.4), (-0.1, 0.2), (-0.5, 0.0)):
        memory = Record(more_friction=more, f_tare=np.zeros(6))
        reason = tick.measure(
            tick_of(
                model=Record(mu=0.3, n_arms=0),
                model_arms=[],
                model_pairs=[],
                model_shapes=[],
                model_columns=[],
                model_bodies=[],
                memory_contacts=[],
                work=work,
                work_arms=[],
                work_joints=[],
                work_columns=[],
                memory_columns=[],
                work_bodies=[],
                memory=memory,
                input_wrenches=np.zeros((0, 6)),
                input_touched=np.zeros((0, 28)),
                work_goal=np.zeros(0),
            )
        )
        assert reason == at.NO_REASON and not work.f_c.any()
        close(work.mu, want, atol=1e-12)
        assert work.more_friction == more


@mark.parametrize("phase", [APPROACHING, CLOSED])
@mark.parametrize("own", [0, tick.OWN_FORCE])
@mark.parametrize("step_time", [0.0, 0.05])
def test_laws_of_the_users_own_have_no_brake_and_no_damping(own, phase, step_time):
    chain = Record(n_columns=2, step_time=step_time, period=1e-3, phased=0)
    contacts = [Record(phase=phase), Record(phase=CLOSED)]
    owners = [Record(contact=0), Record(contact=1)]
    memory = Record(ticked=1, step_left=0.0, step_time=0.05)
    kept = [
        Record(drift=0.1, has_desired=0, desired=0.0, scale=0.0, to_come=np.zeros(3))
        for _ in range(2)
    ]
    columns = [
        Record(chosen=j, goal=9.0, scale=9.0, shaped=9, to_come=np.ones(3)) for j in range(2)
    ]
    work = Record(
        rank=2,
        count=2,
        dt=1e-3,
        keep=[0.0, 1.0],
        step_left=9.0,
        step_time=9.0,
        integral_scale=9.0,
        alpha_d=np.zeros(2),
        gain=np.array([3.0, 4.0]),
        damping=np.array([5.0, 6.0]),
        brake=np.array([7.0, 8.0]),
        speed=np.array([0.3, 0.4]),
        felt=np.zeros(2),
        alpha_meas=np.array([1.0, 2.0]),
    )
    flat = np.array([11.0, 12.0, 0.0, 0.0, 0.0, 0.0])
    tick.set_desired_forces(
        tick_of(
            model=chain,
            model_columns=owners,
            memory_contacts=contacts,
            memory=memory,
            memory_columns=kept,
            work_columns=columns,
            work=work,
            work_goal=flat[:2],
            work_alpha=np.zeros(2),
            work_speeds=np.zeros(2),
        ),
        own,
    )
    near = phase == APPROACHING
    steps = step_time > 0.0 and not own  # from what is measured, and the integral rests
    close(work.alpha_d, [1.0 if steps and not near else 11.0, 2.0 if steps else 12.0])
    close(work.gain, [10.0 if near else 0.0 if steps else 3.0, 0.0 if steps else 4.0])
    close(work.felt, [5.0 * 0.3 if near else 1.0, 2.0])
    close(work.brake, [0.0, 0.0] if own else [7.0 * 0.2, 8.0 * 0.3])
    if own:
        close(work.damping, [5.0 if near else 0.0, 0.0])
        assert (work.integral_scale, work.step_left) == (1.0, 0.0)
        for column, goal in zip(columns, flat, strict=False):
            assert (column.goal, column.scale, column.shaped) == (goal, 0.0, 0)
            assert not column.to_come.any()
    else:
        close(work.damping, [5.0, 6.0])


def a_tick():
    """A controller of two contacts after a tick, and what the law was given."""
    chain = scara_pair()
    rng = rng_of(0)
    q, v = random_state(chain, rng)
    pairs = random_faces(chain.state(q, v).X_WO, 2, rng)
    controller = osc.Controller(chain, pairs, safety=UNLIMITED)
    tick = controller._rows
    seen = []
    controller._rows = lambda *given: seen.append(given) or tick(*given)
    controller.tick(*inputs(chain, q, v, rng, 2, motion_of(rng, 2)))
    memory = controller._records.memory
    assert memory.reason == at.NO_REASON and memory.engaged
    controller._records.job[0] = MOVING
    return tick, seen[-1], memory


def test_inputs_of_other_sizes_are_none():
    tick, given, memory = a_tick()
    for place in range(2, 10):
        x = given[place]
        for other in (x[:-1], np.concatenate((x, x[:1]))):
            changed = (*given[:place], np.ascontiguousarray(other), *given[place + 1 :])
            tick(*changed)
            assert (memory.status, memory.reason) == (at.HELD, at.BAD_INPUT), place


@mark.parametrize("place", [2, 3])
@mark.parametrize("count", [-1, 1])
def test_joints_of_another_number_are_not_read(place, count):
    """What stands beyond their end, or one of them more, moves nothing that is held."""
    found = []
    for more in (0.01, -2.0):
        tick, given, memory = a_tick()
        x = np.concatenate((given[place], np.zeros(2)))
        n = len(given[place]) + count
        x[n if count < 0 else n - 1 :] = more
        x[0] += more if count > 0 else 0.0
        torques = []
        for _ in range(40):
            tick(*given[:place], x[:n], *given[place + 1 :])
            torques.append(memory.torques.copy())
        found.append((torques, memory.state))
    assert_array_equal(found[0][0], found[1][0])
    assert found[0][1] == found[1][1] == at.SAFE_STOP


@mark.parametrize(("r", "m"), [(0, 0), (2, 2), (3, 0)])
@mark.parametrize("held", [0, 1])
def test_the_motion_integral_is_handed_over_as_a_wrench(r, m, held):
    rng = rng_of(10 * r + m)
    e = Energy(rng)
    V = rng.normal(size=(6, 6))
    H = np.eye(6)
    beta = 2.0 / (V * V).sum(axis=1)
    for k in range(m):
        H = (np.eye(6) - beta[k] * np.outer(V[k], V[k])) @ H
    N_t = rng.normal(size=(r, 6))
    Lambda = rng.normal(size=(6, 6))
    Q, R = np.linalg.qr(N_t[:, m:].T)
    work = Record(
        **e.given(),
        rank=r,
        locked=m,
        reflectors=V,
        beta=beta,
        N_t=N_t,
        Lambda=Lambda,
        Q_t=np.pad(Q.T, ((0, 0), (m, 0))),
        L_t=R.T,
        s=np.zeros(6),
        y=np.zeros(6),
        z=np.zeros(6),
    )
    total = np.arange(6.0) - 2.0
    before = np.full(6, 0.5)
    memory = Record(motion_sum=total.copy(), f_bias=before.copy())
    tick.hand_over(tick_of(model=Record(integral=3.0, held=held), work=work, memory=memory))
    to_energy = H @ e.motion
    x = to_energy @ (3.0 * total)
    # what contacts see of a locked motion is not lost
    free = x[m:] + np.linalg.pinv(N_t[:, m:]) @ (N_t[:, :m] @ x[:m])
    force = (Lambda[m:, m:] + held * np.eye(6 - m)) @ free
    close(memory.f_bias - before, to_energy[m:].T @ force, rtol=1e-6, atol=1e-7)
    assert not memory.motion_sum.any()


def ask_command(flags=0, rank=2, missing=0, integral=2.0, **more):
    """α_u, the integrals and a_u of one tick whose columns and motions are alone."""
    seen = {}
    decide = tick.altered(
        "command",
        filter_motion=lambda t: seen.get("reason", at.NO_REASON),
        command_object=lambda t: seen.update(bias=t.memory.f_bias),
        hand_over=lambda t: seen.update(handed=True),
        reduce_motion=lambda *given: seen.update(reduced=True),
    )
    chain = Record(
        period=1e-3,
        integral_force=5.0,
        integral_motion=0.8,
        integral=integral,
        stiffness=3.0,
        damping=4.0,
    )
    work = Record(
        rank=2,
        dt=1e-3,
        n_lost=0,
        locked=0,
        gain=np.array([20.0, 30.0]),
        w=np.zeros(6),
        alpha_d=np.array([8.0, 9.0]),
        felt=np.array([6.0, 10.0]),
        speed=np.array([0.01, 0.02]),
        damping=np.array([100.0, 0.0]),
        least=np.full(2, -inf),
        force_next=np.zeros(2),
        alpha_u=np.full(2, 7.0),
        motion_next=np.array([100.0, -900.0, 900.0, 0.0, 0.0, 0.0]),
        error=np.arange(6.0),
        V_O=np.zeros(6),
        a_u=np.full(6, 7.0),
    )
    memory = Record(
        force_sum=np.array([0.5, -0.5]),
        force_rank=rank,
        wrench_missing=missing,
        hand_over=0,
        motion_sum=np.full(6, 0.1),
        f_bias="bias",
    )
    for name, value in more.items():
        setattr(work if hasattr(work, name) else memory, name, value)
    given = Record(V_D=np.ones(6), A_D=np.ones(6))
    reason = decide(tick_of(model=chain, work=work, memory=memory, input=given), flags)
    return reason, work, memory, seen


def test_laws_and_integrals_of_a_tick():
    reason, work, memory, seen = ask_command()
    assert (reason, seen) == (at.NO_REASON, {"bias": "bias"})
    close(work.force_next, [0.54, -0.53])
    close(work.alpha_u, [8.0 + 0.54 - 1.0, 9.0 - 0.53])
    close(work.motion_next, [0.2, -0.4, 0.4, 0.1, 0.1, 0.1])  # no further than 0.8 / 2
    close(work.a_u, 1.0 + 4.0 + 3.0 * np.arange(6.0) + 2.0 * work.motion_next)
    close(ask_command(rank=1)[1].force_next, [0.04, -0.03])  # another number begins anew
    close(ask_command(missing=1)[1].force_next, [0.5, -0.5])  # nothing to compare with
    close(ask_command(integral=0.0)[1].motion_next, [0.2, -0.8, 1.0, 0.1, 0.1, 0.1])
    _, _, memory, seen = ask_command(hand_over=1)
    assert seen["handed"] and memory.hand_over == 0
    for lost, locked, reduced in ((1, 5, True), (1, 6, False), (0, 5, False)):
        assert ("reduced" in ask_command(n_lost=lost, locked=locked)[3]) == reduced
    _, work, _, _ = ask_command(tick.OWN_FORCE)
    close(work.alpha_u, [8.0 - 1.0, 7.0])  # approached; the user's own
    close(work.force_next, [0.5, -0.5])
    close(ask_command(tick.OWN_FORCE, rank=1)[1].force_next, [0.0, 0.0])
    close(ask_command(tick.OWN_MOTION)[1].a_u, 7.0)
    close(ask_command(tick.OWN_MOTION)[1].alpha_u, ask_command()[1].alpha_u)


# --- phases ---------------------------------------------------------------------------------------


def test_contacts_take_part_as_their_phase_says():
    chain = Record(
        n_contacts=6,
        n_columns=0,
        force_gain=3.0,
        force_damping=5.0,
        force_brake=0.5,
        approach_damping=200.0,
        least_force=0.4,
    )
    cases = [(phase, pushes) for phase in (OPEN, APPROACHING, CLOSED) for pushes in (0, 1)]
    contacts = [Record(phase=phase) for phase, _ in cases]
    bodies = [Record(pushes=pushes) for _, pushes in cases]
    phases.set_goals(
        tick_of(
            model=chain,
            model_bodies=bodies,
            model_columns=[],
            memory_contacts=contacts,
            memory_columns=[],
            work_goal=[],
        )
    )
    for contact, (phase, pushes) in zip(contacts, cases, strict=True):
        near = phase == APPROACHING
        found = contact.active, contact.gain, contact.damping, contact.brake, contact.least
        assert found == (
            int(phase != OPEN),
            0.0 if near else 3.0,
            200.0 if near else 5.0,
            0.0 if near else 0.5,
            0.4 if pushes and not near else -inf,
        )


@mark.parametrize(
    ("phase", "pushes", "since", "gap", "pace", "want"),
    [
        (CLOSED, 1, 9.0, 0.0, 0.0, 8.0),
        (CLOSED, 1, 0.1, 0.0, 0.0, 2.0 + 0.25 * 6.0),
        (CLOSED, 0, 0.1, 0.0, 0.0, 8.0),
        (APPROACHING, 0, 0.1, 0.0, 0.0, 0.5),
        (APPROACHING, 1, 0.1, 0.0, 0.0, 0.5),
        (APPROACHING, 1, 0.1, 0.0, -0.004, 0.5 + 0.8),
        (APPROACHING, 1, 0.1, 0.0, 0.1, 2.0),
        (APPROACHING, 1, 0.1, 0.006, 0.0, 2.0),
        (APPROACHING, 1, 0.1, 0.006, 0.02, 6.0),
        (APPROACHING, 1, 0.1, 0.006, 0.1, 8.0),
        (APPROACHING, 1, 0.1, 9.0, 0.1, 20.0),
        (APPROACHING, 1, 9.0, 9.0, 0.1, 0.0),
    ],
)
def test_goals_of_contacts(phase, pushes, since, gap, pace, want):
    """K_a v_a = 2 N while it is approached, from 0.5 N on; faster back over a known gap."""
    chain = Record(
        n_contacts=1,
        n_columns=1,
        force_gain=3.0,
        force_damping=5.0,
        force_brake=0.5,
        approach_damping=200.0,
        approach_speed=0.01,
        least_force=0.4,
        travel=0.05,
        force_on=1.0,
        rise=0.4,
    )
    for slow, fast in ((pace, -9.0), (9.0, pace), (pace, pace)):  # the slower one counts
        contact = Record(phase=phase, since=since)
        goal = np.array([8.0])
        column = Record(gap=gap, filtered_speed=slow, speed=fast)
        phases.set_goals(
            tick_of(
                model=chain,
                model_bodies=[Record(pushes=pushes)],
                model_columns=[Record(contact=0)],
                memory_contacts=[contact],
                memory_columns=[column],
                work_goal=goal,
            )
        )
        close(goal[0], want)


def test_integrals_of_dependent_columns_stay_while_no_contact_comes_or_goes():
    """Three columns of two closed contacts share two integrals; a third contact is open."""
    chain = Record(n_columns=4)
    owners = [Record(contact=c) for c in (0, 0, 1, 2)]
    contacts = [
        Record(active=1, phase=CLOSED),
        Record(active=1, phase=APPROACHING),
        Record(active=0, phase=OPEN),
    ]

    def remapped(kept):
        memory = Record(force_rank=2, force_sum=np.array([1.5, -2.5, 0.0, 0.0, 0.0, 0.0]))
        phases.remap_force_sums(
            tick_of(
                model=chain,
                memory=memory,
                model_columns=owners,
                memory_contacts=contacts,
                work_here=kept,
                work_alpha=np.zeros(4),
            )
        )
        return memory.force_rank, memory.force_sum[:2].tolist()

    assert remapped([1, 1, 1, 0]) == (2, [1.5, -2.5])
    assert remapped([1, 1, 0, 0])[0] == 0, "contact was lost"
    contacts[2].phase = APPROACHING
    assert remapped([1, 1, 1, 0])[0] == 0, "it comes"


def test_what_is_remembered_of_columns_in_force():
    n = 3
    seen = {}
    remember = tick.altered("remember")
    names = remember.__globals__
    names["keep_steps"] = lambda t: seen.update(steps=[t.work.here.copy(), t.work.alpha.copy()])
    names["phases"] = Record(
        low_pass=lambda t, independent: seen.update(
            here=t.work.here.copy(), chosen=t.work.chosen.copy(), independent=independent
        )
    )
    for phased in (0, 1):
        seen.clear()
        chain = Record(n_columns=n, phased=phased, period=1e-3, lag=0.01)
        work = Record(
            rank=2,
            count=2,
            dt=1e-3,
            status=at.OK,
            more_friction=0.2,
            X_WO=np.ones((4, 4)),
            force_next=np.array([1.0, 2.0]),
            motion_next=np.arange(6.0),
            weightless=0,
            alpha_meas=np.array([5.0, 6.0]),
            speed=np.array([0.3, 0.4]),
            mobility=None,
            D=None,
            E=None,
        )
        memory = Record(
            ticked=4,
            fresh=0,
            located=0,
            more_friction=0.0,
            X_WO=np.zeros((4, 4)),
            force_sum=np.zeros(6),
            force_rank=0,
            motion_sum=np.zeros(6),
        )
        columns = [Record(chosen=2), Record(chosen=0), Record(chosen=1)]
        kept = [Record(alpha=9.0, speed=9.0) for _ in range(n)]
        here, alpha, speeds = np.full((3, n), 7.0)
        remember(
            tick_of(
                model=chain,
                work=work,
                memory=memory,
                work_columns=columns,
                memory_columns=kept,
                work_here=here,
                work_alpha=alpha,
                work_speeds=speeds,
                work_chosen=np.zeros(n, int),
            )
        )
        assert (memory.ticked, memory.fresh, memory.located) == (5, 1, 1)
        assert_array_equal(here, [1.0, 0.0, 1.0])
        assert [(row.alpha, row.speed) for row in kept] == [(6.0, 0.4), (0.0, 0.0), (5.0, 0.3)]
        assert memory.force_rank == 2 and memory.force_sum[:2].tolist() == [1.0, 2.0]
        assert_array_equal(memory.motion_sum, np.arange(6.0))
        assert ("here" in seen) == bool(phased)
        if phased:
            assert_array_equal(seen["here"], [1.0, 0.0, 1.0])
            assert seen["chosen"].tolist() == [2, 0, 0] and seen["independent"]


# --- torques beyond the motors --------------------------------------------------------------------


def settled(ticked, n_arms=2, n_internal=1, rate=100.0):
    """What `settle` makes of 6 and −1 N m found where 0 and 0 were given: torques, squeeze."""
    rows = Rows(new_model(n_arms, 2, 2, columns=1))
    model, memory, work, _ = views(rows)
    model.torque_rate = rate
    model.phase_rate = 1.0
    model.period = 1e-3
    model.joints["motor"] = [1, 0]
    model.joints["tau_max"] = [10.0, 30.0]
    memory.ticked = ticked
    work.n_internal = n_internal
    work.rank = 1
    work.internal[0] = 8.0
    work.force_next[0] = 3.0
    work.gain[0] = 20.0
    work.dt = 1e-3
    program = TorqueLimits(2, 1, 1)
    program.tau[:] = 6.0, -1.0
    program.lost_force[0] = 50.0
    program.lost_squeeze[0] = 5.0
    settle(rows.raw, 0, 0, program.raw)
    close(memory.force_sum[0], 3.0 - 20.0 * 1e-3 * 50.0)
    assert memory.force_rank == 1
    return memory.torques.copy(), work.internal[0]


def test_torques_within_the_limits_change_no_faster_than_others():
    close(settled(1)[0], [6.0, -1.0])  # the first tick has none before it
    close(settled(2)[0], [3.0, -0.5])  # 100/s of 30 N m, in 1 ms
    close(settled(2, rate=1e9)[0], [6.0, -1.0])
    assert settled(2)[1] == 3.0
    assert settled(2, n_internal=0)[1] == 8.0, "what is lost is of an older tick"
    assert settled(2, n_arms=3)[1] == 8.0, "these have bars"
