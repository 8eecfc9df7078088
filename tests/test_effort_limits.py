"""Motor limits: kept, at the least loss, reported, and not integrated."""

import pickle
from dataclasses import replace

import daqp
import numpy as np
from complaints import model_error
from kkt_oracle import held
from numpy.linalg import cholesky, lstsq, solve, svd
from numpy.random import default_rng
from numpy.testing import assert_array_equal
from pytest import approx
from rigs import (
    UNLIMITED,
    assert_near,
    held_tick,
    in_contact,
    largest,
    one_panda,
    panda_pair,
    scara_pair,
    strong,
    ticked,
    unit,
    unloaded,
    vector,
    with_motors,
    within,
    without_contacts,
)
from samples import aligned, module_fixture, parametrize
from scenario_runs import run_of

import osc_contact as osc
from benchmarks.cases import CASES

GAINS = osc.Gains(osc.MotionGains(400, 40, 2000), osc.ForceGains(30, 5))
FORCE = 1e-3
SQUEEZE = 1e-5
TORQUE = 1e-7
POSTURE = 0.1
FLOOR = 1.0
MAX = np.finfo(float).max


def motors_only(chain, pairs):
    """A controller for states drawn at random: no limits but those of its motors."""
    return osc.Controller(chain, pairs, GAINS, safety=UNLIMITED, reading="filter")


def idle_motions(state, chain):
    """(p, n_a) null spaces of NᵀJ of the redundant arms, orthonormal by M."""
    rows = []
    for arm, part in aligned(state.arms, chain.slices):
        null = svd(arm.N.T @ arm.J)[2][arm.rank :].T
        rows.append(np.zeros((null.shape[1], chain.nq)))
        rows[-1][:, part] = solve(cholesky(null.T @ arm.M @ null), null.T)
    return np.vstack(rows)[:, chain.actuated]


def demanding(chain, rng, r):
    """Controller, measurement and reference of a tick that motors with `share` could not make."""
    state, _, pairs, q, v = in_contact(chain, rng, r)
    reference = osc.Reference(
        state.X_WO, state.V_O, 2 * rng.standard_normal(6), rng.uniform(5, 20, r), 5.0
    )
    return (pairs, unloaded(q, v, len(chain.arms)), reference)


def limited_tick(chain, rng, r, share):
    """A saturated controller; its limits are `share` of what the tick asks of each motor's size."""
    while True:
        pairs, measurement, reference = demanding(chain, rng, r)
        # what the tick asks: the torques of stronger motors in the same proportions
        desired = ticked(motors_only(strong(chain), pairs), measurement, reference)
        weak = with_motors(chain, chain.tau_max * share * largest(desired / chain.tau_max))
        controller = motors_only(weak, pairs)
        tau = controller.tick(measurement, reference)
        assert controller.status is osc.Status.SATURATED, controller.reason
        if not controller.given_up.short:  # else no torques keep the forces in their range
            return (controller, measurement, desired, tau)


def sampled(controller, measurement, desired):
    """What the chain makes of torques, by the KKT system of all bodies: affine, so sampled.

    Returns:
        Accelerations of the object, contact forces and squeeze: of the torques desired, and the
        slope along torques as shares of their limits.
    """
    chain = controller.chain
    line = np.zeros(6)
    if len(chain.arms) == 2:
        grasps = controller.signals.state.grasp_points
        line[:3] = unit(grasps[1] - grasps[0])
    whole = held(chain, measurement.q, measurement.v, controller.contacts)

    def at(tau):
        got = whole.answer(tau)
        half = 0.5 * line @ (got.loops[0] - got.loops[-1])
        return np.concatenate((got.a_object, got.alpha, [half]))

    base = at(desired)
    return (base, np.array([at(desired + step) - base for step in np.diag(chain.tau_max)]).T)


def energy_rows(controller, slope):
    """Rows whose squares make the energy of what is given up."""
    chain = controller.chain
    state = controller.signals.state
    N = controller.signals.contact.N
    r = N.shape[1]
    inertia = state.payload.Lambda
    rows = np.vstack(
        (
            cholesky(inertia).T @ slope[:6],
            np.sqrt(FORCE) * cholesky(N.T @ solve(inertia, N)).T @ slope[6 : 6 + r],
            np.sqrt(SQUEEZE / chain.payload.inertia.mass) * slope[6 + r :],
            np.sqrt(POSTURE) * idle_motions(state, chain) * chain.tau_max,
        )
    )
    size = np.sqrt((rows**2).sum() / rows.shape[1])
    return np.vstack((rows, np.sqrt(TORQUE) * size * np.eye(rows.shape[1])))


@parametrize("share", [0.95, 0.6])
@parametrize("rig", [scara_pair, panda_pair, one_panda])
def test_the_least_energy_is_lost_and_what_is_lost_is_reported(rig, share):
    """KKT conditions of the program, its matrices sampled from the full multibody system."""
    chain = rig()
    rng = default_rng(40)
    for k in range(8):
        controller, measurement, desired, tau = limited_tick(chain, rng, k % 4, share)
        base, slope = sampled(controller, measurement, desired)
        cost = controller.given_up
        s = controller.signals
        forces = slice(6, 6 + s.contact.r)
        n = len(tau)
        limit = controller.chain.tau_max
        assert within(tau, limit)
        z = (tau - desired) / limit
        got = base + slope @ z
        # what came is what was reported; test_law_kkt judges force and motion that are lost
        assert_near(base[forces], s.alpha_u, atol=1e-6)
        if len(chain.arms) == 2:
            assert base[-1] - got[-1] == approx(cost.squeeze[0], abs=1e-5)
        # forces stay between their floor and what was commanded
        floor = np.minimum(FLOOR, s.alpha_u)
        assert (got[forces] >= floor - 1e-5).all() and (cost.force >= -1e-6).all()
        at_limit = chain.actuated[limit - np.abs(tau) < 1e-9]
        assert cost.joints == tuple(chain.joint_names[i] for i in at_limit)
        assert cost.joints and all(name in controller.reason for name in cost.joints)
        # stationary, with multipliers of the right sign: of motors, of forces at either end
        rows = energy_rows(controller, slope)
        gradient = rows.T @ (rows @ z)
        C = np.vstack((-np.eye(n) * np.sign(tau), slope[forces], -slope[forces]))
        slack = np.concatenate((limit - np.abs(tau), got[forces] - floor, cost.force))
        C = C[slack < np.repeat([1e-9, 1e-6], [n, len(slack) - n])].T
        multipliers, *_ = lstsq(C, gradient, rcond=1e-9)
        weight = largest(rows.T @ np.abs(rows @ z)) + largest(gradient)
        assert_near(C @ multipliers, gradient, atol=1e-5 * weight)
        assert (multipliers >= -1e-5 * largest(multipliers)).all()


@parametrize("rig", [scara_pair, panda_pair])
def test_the_order_of_contacts_that_may_pull_and_may_not_changes_nothing(rig):
    chain = rig()
    rng = default_rng(44)
    for _ in range(6):
        pairs, measurement, reference = demanding(chain, rng, 2)
        pairs[0] = osc.GapFunctions(pairs[0].gaps, length=0.1)
        desired = ticked(motors_only(strong(chain), pairs), measurement, reference)
        weak = with_motors(chain, 0.5 * chain.tau_max * largest(desired / chain.tau_max))
        found = []
        for order in ([0, 1], [1, 0]):
            controller = motors_only(weak, [pairs[i] for i in order])
            given = replace(reference, alpha_d=reference.alpha_d[order])
            found.append(controller.tick(measurement, given))
            assert controller.status is osc.Status.SATURATED, controller.reason
        assert_near(*found, rtol=1e-6)


def test_an_unsolved_program_ends_held_within_the_limits(monkeypatch):
    chain = scara_pair()
    pairs, measurement, reference = demanding(chain, default_rng(44), 1)
    weak = 0.02 * chain.tau_max
    controller = motors_only(with_motors(chain, weak), pairs)
    controller.tick(measurement, reference)
    assert controller.status is osc.Status.SATURATED
    sums = controller.force_integral
    monkeypatch.setattr(daqp, "solve", lambda *a, **k: (np.full(8, np.nan), 0.0, -3, {}))
    more = replace(reference, alpha_d=reference.alpha_d + 1)
    tau = held_tick(controller, "limits", measurement, more)
    assert within(tau, weak) and controller.given_up is None
    assert pickle.loads(pickle.dumps(controller)).reason == controller.reason
    assert_array_equal(controller.force_integral, sums)


def test_motors_without_limit():
    """DBL_MAX and inf are no limits: torques are finite, and those of strong motors."""
    chain = one_panda()
    pairs, measurement, reference = demanding(chain, default_rng(45), 2)
    model = chain.arms[0].model.copy()
    model.upperEffortLimit = np.full(7, MAX)
    endless = osc.ClosedChain([replace(chain.arms[0], model=model)], chain.grasps, chain.payload)
    assert np.isinf(endless.tau_max).all()
    found = []
    for one in (endless, with_motors(chain, np.full(7, 1e6))):
        found.append(ticked(motors_only(one, pairs), measurement, reference))
    assert_near(found[0], found[1], atol=1e-9 * largest(found[1]))


@parametrize("limit", [0.0, -3.0])
def test_a_motor_that_can_do_nothing_is_refused(limit):
    arm = one_panda().arms[0]
    model = arm.model.copy()
    limits = np.array(model.upperEffortLimit)
    limits[2] = limit
    model.upperEffortLimit = limits
    with model_error(r"arm/panda_joint3.*effort"):
        osc.ClosedChain([replace(arm, model=model)])


def test_integrals_rest_while_motors_are_at_their_limits():
    """The motion integral stays, and the force integral takes back what will not come."""
    chain = scara_pair()
    rng = default_rng(46)
    for _ in range(5):
        pairs, measurement, reference = demanding(chain, rng, 2)
        controller = motors_only(with_motors(chain, 0.03 * chain.tau_max), pairs)
        before = np.zeros(2)
        for _ in range(5):
            controller.tick(measurement, reference)
            assert controller.status is osc.Status.SATURATED
            missing = reference.alpha_d - controller.result().alpha_meas
            expected = before + 30.0 * 1e-3 * (missing - controller.given_up.force)
            before = controller.force_integral
            assert_near(before, expected, atol=1e-9)
        assert_array_equal(controller.motion_integral, np.zeros(6))


@module_fixture
def run():
    """Run with integrals in both loops, so that windup would be visible."""
    return run_of("limited_rod", "gains.motion.integral=8000")


def test_limits_are_kept_and_no_contact_opens(run):
    assert within(run["tau"], np.array(list(run.meta["effort_limits"].values())))
    assert (run["status"] == 1).sum() > 500 and not (run["status"] == 2).any()
    assert run["closed"][run["t"] > 0.05].all() and (run["alpha_true"] >= 0.0).all()


def test_the_verdict_names_the_joints(run):
    verdict = osc.metrics(run)
    joint, ticks = verdict["at_limit"][0]
    assert joint == "right/joint3" and ticks > 500
    assert {name for name, _ in verdict["at_limit"]} <= set(run.meta["effort_limits"])


def test_nothing_winds_up(run):
    """0.2 s after the demand is feasible again force and motion are where they were before."""
    t = run["t"]
    force = np.abs(run["alpha_true"] - run["alpha_cmd"])
    motion = np.abs(run["motion_error"])
    for end in (3.0, 5.25, 6.25):  # the steps of the motion ask too much for a quarter second
        ends = t[(run["status"] == 1) & (t < end + 0.2)].max()
        back = (t >= max(ends, end) + 0.2) & (t < max(ends, end) + 0.5)
        assert_array_equal(run["status"][back], 0)
        assert (force[back] / run["alpha_cmd"][back]).max() < 0.02, end
        assert motion[back, :3].max() < 2e-3 and motion[back, 3:].max() < 2e-3, end


def test_the_other_contact_and_the_motion_are_left_alone(run):
    """A force that is out of reach costs nothing but itself and the squeeze."""
    beyond = (run["t"] > 2.0 + run.meta["force_rise_s"]) & (run["t"] < 3.0)  # the step is let in
    assert_array_equal(run["status"][beyond], 1)
    assert run["alpha_given_up"][beyond, 0].min() > 10.0
    assert np.abs(run["alpha_true"] - run["alpha_cmd"])[beyond, 1].max() < 0.2
    assert largest(run["motion_error"][beyond, :3]) < 1e-3


def test_a_saturated_redundant_arm_does_not_whirl():
    """A jump of the desired speed saturates a wrist: the elbow must not spin to make up for it."""
    case = CASES["one_panda"]()
    plant, controller = without_contacts(case, engaged=False)
    V_D = vector(0.3, 0.2, 0.0, 0.0, 0.0, 0.5)
    desired = replace(case.reference, alpha_d=np.zeros(0), V_D=V_D)
    saturated = 0
    fastest = 0.0
    for _ in range(40):
        plant.command(controller.tick(plant.measure(), desired), 1e-3)
        saturated += controller.status is osc.Status.SATURATED
        fastest = max(fastest, largest(plant.measure().v))
    assert saturated > 5 and fastest < 1.0  # rad/s; 5.1 where idle motions cost nothing
