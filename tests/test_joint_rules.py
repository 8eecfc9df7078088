"""Rules on springs and dry friction of joints, against other ways to the same numbers."""

from dataclasses import replace

import numpy as np
from pytest import approx
from samples import parametrize
from scenario_runs import rig_of
from scipy.linalg import block_diag, eig, null_space

import osc_contact as osc
from benchmarks.random_tasks import draw
from osc_contact.control.joint_torque import RATE_BANDWIDTH
from osc_contact.interface import Measurement
from osc_contact.lab.checks.joint_rules import slow_decay, uncompensated
from osc_contact.lab.checks.spring_poles import (
    permitted_motions,
    poles,
    slowest_oscillation,
    trial_controller,
)
from osc_contact.lab.rig.hardware import torque_loop

# Springs ------------------------------------------------------------------------------------------


def motions_of_grasps(rig):
    """Motions (n + 6, d) of joints and object of which the grasps permit NᵀJ q̇ = NᵀV."""
    n = rig.chain.nq
    grasps = np.zeros((6 * len(rig.state.arms), n + 6))
    for i, (arm, joints) in enumerate(zip(rig.state.arms, rig.chain.slices, strict=True)):
        rows = slice(6 * i, 6 * i + arm.N.shape[1])
        grasps[rows, joints] = arm.N.T @ arm.J
        grasps[rows, n:] = -arm.N.T
    return null_space(grasps)


@parametrize("name", ["two_contact_rod", "panda_edge", "three_arm_plate", "scara_peg"])
@parametrize("approaching", [False, True])
def test_all_permitted_motions_have_unit_inertia(name, approaching):
    """With those in which a redundant arm moves and its object rests."""
    rig = rig_of(name)
    state = rig.state
    motions = permitted_motions(rig, approaching)
    Z = motions_of_grasps(rig)
    if not approaching:
        Z = Z @ null_space(rig.contact.N.T @ Z[rig.chain.nq :])
    assert np.linalg.matrix_rank(motions) == motions.shape[1] == Z.shape[1]
    all_of_them, *_ = np.linalg.lstsq(Z[: rig.chain.nq], motions, rcond=None)
    assert Z[: rig.chain.nq] @ all_of_them == approx(motions, abs=1e-9 * np.abs(motions).max())
    V = Z[rig.chain.nq :] @ all_of_them
    inertia = motions.T @ state.M @ motions + V.T @ state.payload.Lambda @ V
    assert inertia == approx(np.eye(len(inertia)), abs=1e-8)


def poles_of_a_rig_on_springs(rig, approaching):
    """Poles (1/s) of joints, object, motors, torque loop, rigid contacts and force integral.

    Nothing is sampled or late. Motions Z of joints and object have coordinates z. The torques of
    the law are linear in positions and speeds, by differences of ticks.
    The equations of motion have the contact forces as unknowns, and as states the integral and the
    estimate y, h of the loop, with the springs' torques f = k(q − θ):

        ZᵀMZ z̈ + ZᵀJf = ZᵀN α,  J_m θ̈ − f = u,  NᵀZ ż = 0,  ξ̇ = α,
        u = τ + k_p(τ + f) − k_d h,  ẏ = h + 2ω(−f − y),  ḣ = ω²(−f − y).
    """
    state, chain, springs = rig.state, rig.chain, rig.springs
    loop = torque_loop(rig.scenario, chain, springs)
    n, n_a = chain.nq, chain.n_a
    Z = motions_of_grasps(rig)
    d = Z.shape[1]
    N = rig.contact.N if not approaching else np.zeros((6, 0))
    Z_N = Z[n:].T @ N
    r = Z_N.shape[1]

    def tau(q, v):
        controller, measured = trial_controller(rig)
        controller.tick(measured, rig.references.at(0.0))
        moved = Measurement(measured.q + q, v, measured.wrenches, touched=measured.touched)
        return controller.tick(moved, rig.references.at(0.0))

    step = 1e-6
    zero = np.zeros(n)
    by_q = np.array([tau(step * w, zero) - tau(-step * w, zero) for w in Z[:n].T]).T / (2 * step)
    by_v = np.array([tau(zero, step * w) - tau(zero, -step * w) for w in Z[:n].T]).T / (2 * step)
    stretch = np.hstack([Z[:n][chain.actuated], -np.eye(n_a)])
    k_p, k_d, omega = 0.0, np.zeros(n_a), np.ones(n_a)
    if loop is not None:
        k_p, k_d, omega = loop.gain, loop.rate_gain, RATE_BANDWIDTH * loop.bandwidth
    # torques of the springs and of the motors, of z, θ, ż, θ̇, ξ, y and h
    m = d + n_a
    size = 2 * m + r + 2 * n_a
    f = np.zeros((n_a, size))
    f[:, :m] = springs.stiffness[:, None] * stretch
    f[:, m : 2 * m] = springs.damping[:, None] * stretch
    u = np.zeros((n_a, size))
    u[:, :d] = by_q
    u[:, m : m + d] = by_v
    limits = chain.tau_max
    pushes = np.linalg.pinv(state.G * limits) * limits[:, None] @ state.S.T @ N
    u[:, 2 * m : 2 * m + r] = rig.gains.force.integral * pushes
    u = (1.0 + k_p) * u + k_p * f
    u[:, 2 * m + r + n_a :] -= np.diag(k_d)
    u[:, m + d : 2 * m] -= np.diag(chain.model.damping[chain.actuated])
    inertia = block_diag(state.M, state.payload.Lambda)
    mass = block_diag(Z.T @ inertia @ Z, np.diag(springs.motor_inertia))
    E = block_diag(np.eye(m), mass, np.eye(r + 2 * n_a), np.zeros((r, r)))
    A = np.zeros((size + r,) * 2)
    A[:m, m : 2 * m] = np.eye(m)
    A[m : 2 * m, :size] = -stretch.T @ f
    A[m + d : 2 * m, :size] += u
    A[m : m + d, size:] = Z_N
    A[2 * m : 2 * m + r, size:] = np.eye(r)
    estimate = slice(2 * m + r, 2 * m + r + n_a)
    rate = slice(2 * m + r + n_a, size)
    A[estimate, :size] = -2.0 * omega[:, None] * f
    A[rate, :size] = -(omega[:, None] ** 2) * f
    A[estimate, estimate] -= 2.0 * np.diag(omega)
    A[rate, estimate] -= np.diag(omega**2)
    A[estimate, rate] = np.eye(n_a)
    A[size:, m : m + d] = Z_N.T
    found = eig(A, E, right=False)
    return found[np.isfinite(found) & (np.abs(found) < 1e8)]


def slowest_of(found):
    """Pole of the slowest oscillation above 5 Hz, of damping ratios up to 0.9."""
    oscillations = [s for s in found if s.imag > max(2.0 * np.pi * 5.0, 0.5 * abs(s.real))]
    return max(oscillations, key=lambda s: s.real)


#: Changes by which a scenario has no contacts.
FREE = ("contacts=[]", "force={}", "environment=[]")
WITH_LOOP = "joint_torque: {rate: 1000 kHz, gain: 5}, "


@parametrize("loop", ["", WITH_LOOP])
@parametrize("name, changes", [("two_contact_rod", ()), ("panda_edge", ()), ("panda_edge", FREE)])
@parametrize("hertz", [15.0, 60.0])
def test_the_decay_of_springs_is_that_of_the_poles(name, changes, hertz, loop):
    """At a rate at which nothing is late."""
    rig = rig_of(
        name,
        f"plant.flexible_joints.frequency={hertz} Hz",
        "gains={motion: {frequency: 1 Hz}, force: {bandwidth: 1 Hz, damping_ratio: 1}}",
        f"control={{{loop}rate: 1000 kHz}}",
        "plant.step=0.001 ms",
        *changes,
    )
    for approaching in (False, True):
        found = slowest_of(poles(rig, approaching))
        expected = slowest_of(poles_of_a_rig_on_springs(rig, approaching))
        assert found.real == approx(expected.real, rel=0.05, abs=0.1)
        assert found.imag == approx(expected.imag, rel=0.05)


def test_a_light_wrist_behind_a_torque_loop_swings_as_it_approaches():
    """At 250 Hz the damping of the approach, 200 N s/m, is too large for it."""
    task = draw(852115, 45)
    found = []
    for damping, speed in ((200.0, 0.01), (36.0, 0.02)):
        life = f"control.life={{damping: {damping}, speed: {speed}}}"
        rig = osc.build_rig(replace(task, changes=[*task.changes, life, "duration=2"]).load())
        slowest = slowest_oscillation(rig)
        doubts = [one.text for one in osc.preflight(rig) if "joint springs" in one.text]
        run = osc.run(rig.scenario, seed=45, check=lambda _: [])
        found.append((slowest, doubts, osc.metrics(run)["task"]["word"]))
    (fast, (doubt,), word), (slow, none, good) = found
    assert fast.approaching and fast.decay < -20.0 and "lower control.life.damping" in doubt
    assert slow.decay > 3.0 and not none
    assert (word, good) == ("STOPPED", "OK")


def test_springs_of_motors_with_friction_are_doubted_by_their_decay():
    """First modes of 30 and 90 Hz are both below 100 Hz, the limit without friction."""
    found = {}
    for hertz in (30.0, 90.0):
        springs = f"plant.flexible_joints.frequency={hertz} Hz"
        rig = rig_of("two_contact_rod", springs, "plant.joint_friction=0.001")
        (decay,) = (-value for value, _ in slow_decay.quantity(rig))
        found[decay] = [one.text for one in osc.preflight(rig) if "joint springs" in one.text]
    slow, fast = sorted(found)
    assert slow < 3.0 < fast
    assert not found[fast] and "decays at no more than" in found[slow][0]


# Dry friction -------------------------------------------------------------------------------------


@parametrize("name, known, share", [("panda_edge", 0.0, 1.0), ("panda_edge", 1.3, 0.4)])
def test_friction_that_no_model_has_changes_forces_as_pinocchio_has_it(name, known, share):
    """Forces of constraints Nᵀ(J q̈) = 0 of the arm with its object under the joints' friction."""
    friction = np.linspace(1.0, 4.0, 7)
    rig = rig_of(
        name,
        f"arms.panda.friction={friction.tolist()}",
        f"model_error.joint_friction={known}",
    )
    (arm,) = rig.state.arms
    M = arm.M + arm.J.T @ rig.state.payload.Lambda @ arm.J
    J_c = rig.contact.N.T @ arm.J
    r, n = J_c.shape
    kkt = np.block([[M, J_c.T], [J_c, np.zeros((r, r))]])
    forces = np.linalg.inv(kkt)[n:, :n] * (share * friction)
    expected = np.sqrt((forces**2).sum(axis=1))
    assert [words["force"] for _, words in uncompensated.quantity(rig)] == approx(expected)


def test_friction_is_doubted_from_a_third_of_the_force_on():
    def doubts(*changes):
        rig = rig_of("panda_edge", *changes)
        return [one.text for one in osc.preflight(rig) if "dry friction" in one.text]

    assert doubts() == []
    rig = rig_of("panda_edge", "arms.panda.friction=1", "model_error.joint_friction=0")
    largest = max(value for value, _ in uncompensated.quantity(rig))
    for factor, is_doubted in ((0.99, False), (1.01, True)):
        friction = f"arms.panda.friction={factor * 0.3 / largest}"
        assert bool(doubts(friction, "model_error.joint_friction=0")) == is_doubted
        assert not doubts(friction)  # the model has it
    unknown = f"arms.panda.friction={1.01 * 0.3 / largest}"
    assert doubts(unknown, "control.joint_friction=off")
