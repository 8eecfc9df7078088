"""Friction of joints that falls with their speed, and the force integral that contacts can bear.

Friction that has the size F at rest and falls by the share q as the joint moves faster has, with
any Stribeck speed v_s, a negative slope:

    F (1 − q (1 − exp(−(v/v_s)²))),   −slope = 2 q F v/v_s² exp(−(v/v_s)²) ≤ 2 q F/(e v).

Its bound at the speed s of a joint is σ = 2 q F/(e √(s² + s_1²)) less the viscous friction D. A
contact that moves along the column N moves the object by V = Λ_o⁻¹N per unit of its acceleration,
and the joints by J̄V. Falling friction feeds this motion, with the inertia Λ_S of object and arms,
at the rate

    κ_f = Σ σ (J̄V)²/(VᵀΛ_S V),

so that the brake κ leaves a damping of κ − κ_f. On every spring the contact decays if and only if
this exceeds the gain K_i of the force integral (Routh, docs/tuning.md). A larger κ would return
more noise of the encoders, and raises the frequency below which v̄ leaves contacts undamped. So K_i
is reduced to κ − `_MARGIN` κ_f, to a least share of κ, and the rate of v̄ with it.
"""

from __future__ import annotations

from math import sqrt

from osc_contact.law.jit import inner, leaf, local
from osc_contact.law.joint_friction import SLIDES, compensated_theta
from osc_contact.law.vectors import dot6, fill_free

_FALL = 0.3  #: 2 q/e: friction falls by the share q = 0.4
_SLOW = 0.03  #: s_1 (rad/s), speed of an oscillation of joints that do not move else
_MARGIN = 12.0  #: multiple of κ_f; modelled masses may lack rotors, speeds come late


@inner
def limit_integrals(t):
    """Update the share by which gains of force integrals are reduced (`integral_cut` of MEMORY).

    Each tick adds one joint to κ_f (`slope` of MEMORY, 1/s). After a round through all joints the
    share leaves K_i at κ less `_MARGIN` κ_f; it is at most `largest_cut`.

    Args:
        t: Tick whose friction has been compensated.
    """
    memory = t.memory
    j = memory.ticked % t.model.n_joints
    if j == 0:
        excess = t.model.force_gain + _MARGIN * memory.slope - t.model.force_brake
        cut = min(excess / t.model.force_gain, t.model.largest_cut)
        memory.integral_cut = max(cut, 0.0)
        memory.slope = 0.0
    _add_joint(t, j)


@leaf
def _add_joint(t, j):
    """Add the part of joint j to the sum κ_f of this round (`slope` of MEMORY, 1/s).

    Of several columns the parts are added, which is a bound. Reads F and D that are compensated,
    the permitted `speed` s and J̄ of the joint, and the columns N_t, where V = N.

    Args:
        t: Tick.
        j: index of the joint.
    """
    work = t.work
    if t.model.joints[j].motor < 0:
        return
    F, D, _ = compensated_theta(t, j)
    if F <= 0.0:
        return
    slow = _SLOW * (SLIDES if t.model.joints[j].slides else 1.0)
    s = t.memory.joints[j].speed
    slope = _FALL * F / sqrt(s * s + slow * slow) - D
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
