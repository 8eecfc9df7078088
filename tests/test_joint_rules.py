"""Rules on springs and dry friction of joints, against other ways to the same numbers."""

import numpy as np
from pytest import approx
from samples import parametrize
from scenario_runs import rig_of
from scipy.linalg import block_diag, eig

import osc_contact as osc
from osc_contact.interface import Measurement
from osc_contact.lab.checks.joint_rules import (
    slow_decay,
    spring_decay,
    trial_controller,
    uncompensated,
)

# Springs ------------------------------------------------------------------------------------------


def poles_of_a_rig_on_springs(rig):
    """Poles (1/s) of links, motors, rigid contacts and force integral, without delays.

    The torques of the law are linear in positions and speeds of the links, by differences of ticks.
    The equations of motion have the contact forces as unknowns, and the integral as state:

        Λ_S η̈ + W_aᵀk(W_a η − θ) = SᵀN α,  J θ̈ − k(W_a η − θ) = τ,  NᵀS η̇ = 0,  ξ̇ = α.
    """
    state, chain, springs = rig.state, rig.chain, rig.springs
    d, n_a = state.d, chain.n_a
    W_a = state.W[chain.actuated]
    S_N = state.S.T @ rig.contact.N
    r = S_N.shape[1]

    def tau(q, v):
        controller, measured = trial_controller(rig)
        wrenches = np.zeros_like(measured.wrenches)
        moved = Measurement(measured.q + q, v, wrenches, touched=measured.touched)
        return controller.tick(moved, rig.references.at(0.0))

    step = 1e-6
    zero = np.zeros(chain.nq)
    by_q = np.array([tau(step * w, zero) - tau(zero, zero) for w in state.W.T]).T / step
    by_v = np.array([tau(zero, step * w) - tau(zero, zero) for w in state.W.T]).T / step
    stretch = np.hstack([W_a, -np.eye(n_a)])
    K = stretch.T @ (springs.stiffness[:, None] * stretch)
    D = stretch.T @ (springs.damping[:, None] * stretch)
    D[d:, d:] += np.diag(chain.model.damping[chain.actuated])
    K[d:, :d] -= by_q
    D[d:, :d] -= by_v
    mass = block_diag(state.Lambda_S, np.diag(springs.motor_inertia))
    limits = chain.tau_max
    pushes = np.linalg.pinv(state.G * limits) * limits[:, None] @ S_N  # torques of contact forces
    m = d + n_a
    E = block_diag(np.eye(m), mass, np.eye(r), np.zeros((r, r)))
    A = np.zeros((2 * m + 2 * r,) * 2)
    A[:m, m : 2 * m] = np.eye(m)
    A[m : 2 * m, :m] = -K
    A[m : 2 * m, m : 2 * m] = -D
    A[m + d : 2 * m, 2 * m : 2 * m + r] = rig.gains.force.integral * pushes
    A[m : m + d, 2 * m + r :] = S_N
    A[2 * m : 2 * m + r, 2 * m + r :] = np.eye(r)
    A[2 * m + r :, m : m + d] = S_N.T
    poles = eig(A, E, right=False)
    return poles[np.isfinite(poles) & (np.abs(poles) < 1e8)]


#: Changes by which a scenario has no contacts.
FREE = ("contacts=[]", "force={}", "environment=[]")


@parametrize("name, changes", [("two_contact_rod", ()), ("panda_edge", ()), ("panda_edge", FREE)])
@parametrize("hertz", [15.0, 60.0])
def test_the_decay_of_springs_is_that_of_the_poles(name, changes, hertz):
    """At a rate at which nothing is late."""
    rig = rig_of(
        name,
        f"plant.flexible_joints.frequency={hertz} Hz",
        "gains={motion: {frequency: 1 Hz}, force: {bandwidth: 1 Hz, damping_ratio: 1}}",
        "control.rate=1000 kHz",
        "plant.step=0.001 ms",
        *changes,
    )
    decay, frequency = spring_decay(rig)
    poles = poles_of_a_rig_on_springs(rig)
    fast = poles[np.abs(poles.imag) > 2.0 * np.pi * 5.0]
    slowest = fast[np.argmax(fast.real)]
    assert decay == approx(-slowest.real, rel=0.05, abs=0.1)
    assert frequency == approx(abs(slowest.imag) / (2.0 * np.pi), rel=0.05)


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
