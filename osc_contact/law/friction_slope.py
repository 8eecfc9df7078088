"""Friction of joints that falls with their speed, and the force integral that contacts can bear.

Friction that has the size F at rest and falls by the share q as the joint moves faster has, with
any Stribeck speed v_s, a negative slope:

    F (1 − q (1 − exp(−(v/v_s)²))),   −slope = 2 q F v/v_s² exp(−(v/v_s)²) ≤ 2 q F/(e v),

where e is Euler's number. Of a joint with the permitted speed s, σ = 2 q F |s|/(e (s² + s_1²)) − D
is used, with the viscous friction D, where it is positive. Its first term is nearly the bound at
speeds far above s_1, and 0 at rest, because friction damps joints whose speed changes its sign. The
oscillation along the column N has the direction V = Λ_o⁻¹N, an approximation of the contact mode;
joints move by J̄V. Falling friction feeds this motion, with the inertia Λ_S of object and arms, at
the rate

    κ_f = Σ σ (J̄V)²/(VᵀΛ_S V),

so that the brake κ leaves a damping of κ − κ_f. Whatever the stiffness of the contact, its
oscillation decays if and only if this damping exceeds the gain K_i of the force integral (Routh,
docs/tuning.md). A larger κ would return more noise of the encoders, and raise the frequency below
which the brake leaves contacts undamped, because it spares their lasting speed v̄ (`commands`).
So K_i is reduced to κ − `_MARGIN` κ_f, but not below κ/`brake_ratio`, and the rate of v̄ with it.
`_MARGIN` was chosen by measurement.

Friction that residuals show and that is not identified yet excites contacts, too. It counts by the
standard deviation of the estimate of F, which falls while the joint moves at 10 mrad/s or faster:
within some tenths of a second where there is no friction. Without learning this deviation would not
fall, so it does not count. K_i and the rate of v̄ are rates of integrals, so that no torque jumps.
"""

from __future__ import annotations

from math import sqrt

from osc_contact.law.friction_estimate import SUSPECTED
from osc_contact.law.jit import inner, leaf, local
from osc_contact.law.joint_friction import SLIDES, compensated_theta
from osc_contact.law.vectors import dot6, fill_free

_FALL = 0.3  #: 2 q/e: friction falls by the share q = 0.4
_SLOW = 0.03  #: s_1 (rad/s), speed of the oscillation, below which a joint's speed changes its sign
_MARGIN = 12.0  #: multiple of κ_f: masses may lack those of rotors, measured speeds are delayed


@inner
def limit_integrals(t):
    """Update the share by which gains of force integrals are reduced (`integral_cut` of MEMORY).

    The gain is reduced to K_i (1 − share) = κ − `_MARGIN` κ_f if it is larger; by no more than
    `_MARGIN` κ_f, if it exceeds κ without friction, too; and not below κ/`brake_ratio`. Each tick
    adds one joint only to the sum κ_f (`slope` of MEMORY, 1/s), which saves time; the share changes
    after each round through all joints. It is 0 if no friction is compensated, if K_i, κ or
    `brake_ratio` is 0, or if K_i ≤ κ/`brake_ratio` already.

    Args:
        t: Tick whose friction has been compensated, and whose torques are finite.
    """
    memory = t.memory
    model = t.model
    largest = 0.0
    if (
        model.rubs
        and model.brake_ratio > 0.0
        and model.force_brake > 0.0
        and model.force_gain > 0.0
    ):
        largest = max(1.0 - model.force_brake / (model.brake_ratio * model.force_gain), 0.0)
    if largest == 0.0:
        memory.integral_cut = 0.0
        memory.slope = 0.0
        return
    j = memory.ticked % model.n_joints
    if j == 0:
        if not memory.slope >= 0.0:  # NaN does not last
            memory.slope = 0.0
        added = _MARGIN * memory.slope
        excess = max(model.force_gain + added - model.force_brake, 0.0)
        memory.integral_cut = min(min(excess, added) / model.force_gain, largest)
        memory.slope = 0.0
    _add_joint(t, j)


@leaf
def _add_joint(t, j):
    """Add the part of joint j to the sum κ_f of this round (`slope` of MEMORY, 1/s).

    It is Σ_a σ (J̄V_a)²/(V_aᵀΛ_S V_a) over the kept columns a, with V_a = N_a: in energy
    coordinates Λ_o is the identity. Reads F and D that are compensated, the standard deviation of F
    (of `P`) where friction is suspected (`friction_known`), the permitted `speed` s and J̄ of the
    joint, and `N_t` of the columns.

    Args:
        t: Tick.
        j: index of the joint.
    """
    work = t.work
    if t.model.joints[j].motor < 0:
        return
    F, D, _ = compensated_theta(t, j)
    if t.model.friction_learning and t.memory.friction_known[j] == SUSPECTED:
        F += sqrt(max(t.memory.friction[j].P[0, 0], 0.0))
    if F <= 0.0:
        return
    slow = _SLOW * (SLIDES if t.model.joints[j].slides else 1.0)
    s = t.memory.joints[j].speed
    slope = _FALL * F * abs(s) / (s * s + slow * slow) - D
    if slope <= 0.0:
        return
    g = local(6)
    fill_free(g, work, work.joints[j].J_bar)
    for a in range(work.rank):
        along = dot6(work.N_t[a], g)
        t.memory.slope += slope * along * along / _energy(work, work.N_t[a])


@leaf
def _energy(work, N):
    """Compute NᵀΛ_S N, twice the kinetic energy of the motion N of object and arms.

    Args:
        work: WORK, of which `Lambda` and `locked` are read.
        N: (6,) turned energy coordinates.
    """
    energy = 0.0
    for i in range(work.locked, 6):
        for j in range(work.locked, 6):
            energy += N[i] * work.Lambda[i, j] * N[j]
    return energy
