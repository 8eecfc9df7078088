"""Lowest frequency of oscillation of contacts on elastic faces that the model takes as rigid.

A force integral excites the oscillation of a contact whose frequency is not far above its gain
(docs/tuning.md, *Bandwidth*), and no model states how much a wall, a table or the arm itself
yields. Changes of position x and force α of a contact are related by α = k x, whatever causes them.
So the compliance s = 1/k of each contact is estimated,

    s = ∫x̃ α̃ dt / (∫α̃² dt + w_0),

with x̃ the position and α̃ the force after a high-pass, which leaves out sliding along a face that is
tilted against the model. Both integrals forget. Noise of the position is not correlated with α̃,
and α̃ passes a low-pass against noise of its own; w_0 leaves s at zero as long as α̃ is small against
the force. With the mass M = (NᵀΛ_S⁻¹N)⁻¹ behind the contact the frequency is ω = (s M)^−½.
"""

from __future__ import annotations

from math import inf, sqrt

from osc_contact.law.algebra import cholesky, dot, forward
from osc_contact.law.jit import inner, leaf, local
from osc_contact.law.records import YIELDING, body_of
from osc_contact.law.vectors import fill

_HIGH_PASS = 0.5  #: rate of the high-passes, as a share of K_i
_LOW_PASS = 0.016  #: s, time constant of the low-pass of α̃
_PRESSING_SHARE = 0.3  #: share of the size of its force from which on a contact moves its face
_MEMORY = 2.0  #: s, time constant of forgetting
#: s; w_0 is this time multiplied by the squared size of the force: during `_MEMORY` an oscillation
#: with an amplitude of 2 % of the force has as much weight.
_PRIOR_TIME = 4e-4


@leaf
def follow_compliance(t, a, j):
    """Update the integrals ∫x̃ α̃ dt and ∫α̃² dt of a contact force on a face that does not yield.

    Reads `speed` (NᵀV_rel, m/s) and `alpha_meas` (N) of the kept column, the gain K_i (1/s) of
    force integrals, `scale` (size of the force, N) and `has_desired` of the column (0: its force
    begins in this tick). Changes of the column in MEMORY `yielded` (x̃, m; 0 while the contact does
    not press), `alpha_smooth` (N; α after a low-pass) and `alpha_mean` (N; that after another one,
    whose difference to it is α̃), `correlation` (∫x̃ α̃ dt, m N s) and `excitation` (∫α̃² dt, N² s).

    Args:
        t: Tick.
        a: index of the column among the kept ones.
        j: its index among all columns of the model.
    """
    row = t.memory.columns[j]
    dt = t.work.dt
    alpha = t.work.alpha_meas[a]
    rate = _HIGH_PASS * t.model.force_gain
    begins = row.has_desired == 0
    row.alpha_smooth += (1.0 if begins else dt / (_LOW_PASS + dt)) * (alpha - row.alpha_smooth)
    if begins or row.alpha_smooth < _PRESSING_SHARE * row.scale:  # it moves without the face
        row.yielded = 0.0
        row.alpha_mean = row.alpha_smooth
    row.yielded += dt * (t.work.speed[a] - rate * row.yielded)
    row.alpha_mean += rate * dt / (1.0 + rate * dt) * (row.alpha_smooth - row.alpha_mean)
    change = row.alpha_smooth - row.alpha_mean
    forgetting = _MEMORY / (_MEMORY + dt)
    row.correlation = forgetting * row.correlation + dt * change * row.yielded
    row.excitation = forgetting * row.excitation + dt * change * change


@inner
def slowest_mode(t):
    """Estimate the lowest frequency ω (rad/s) at which a contact oscillates; inf if none is known.

    Each column counts by itself, ω² = 1/(s M). Faces declared as yielding are left out, because
    they have a brake of their own. Reads `correlation`, `excitation` and `scale` (size of the
    force, N) of the columns in MEMORY; `N_t`, `Lambda` and `locked` of WORK.

    Args:
        t: Tick.
    """
    work = t.work
    most = 0.0  # largest s M (s²)
    free = 6 - work.locked
    factor = local(6, 6)
    weighted = local(6)  # N, weighted by the inertia Λ_S
    is_factored = False
    for a in range(work.rank):
        j = work.kept[a]
        row = t.memory.columns[j]
        weight = _PRIOR_TIME * row.scale * row.scale
        if body_of(t, j).kind == YIELDING or row.correlation <= 0.0 or weight == 0.0:
            continue
        if not is_factored and not cholesky(work.Lambda, work.locked, free, factor) > 0.0:
            return inf
        is_factored = True
        fill(weighted, work.N_t[a])
        forward(factor, free, weighted[work.locked :])
        mobility = dot(weighted[work.locked :], weighted[work.locked :], free)  # 1/M
        most = max(most, row.correlation / ((row.excitation + weight) * mobility))
    return 1.0 / sqrt(most) if most > 0.0 else inf
