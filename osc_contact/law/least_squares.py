"""Contact forces by least squares: what friction and misplaced normals do not fool.

The filter of fig. 5 takes whatever pushes on the object at a contact for N_μα. Here each point of
contact may push along its tangents, too, by an unknown β, and the object may depart by δ from the
acceleration a that is wanted of it:

    f_meas − bias_out − Λ_out a = N_μα + Σ T_jβ_j + Λ_out δ,   Nᵀδ = 0

Of all α, β and δ that explain the reading those are taken that make the sum of squares least, each
in the scale in which it is likely: β_j in w_j times a coefficient of friction, w_j the force wanted
of the contact; δ, by the kinetic energy of the object, in σ_a. With f all that is read but N_μα,

    R = ΣT_jC_jT_jᵀ + σ_a²m Λ_outPΛ_outᵀ,    α = (N_μᵀR⁻¹N_μ)⁻¹N_μᵀR⁻¹f,

P the motions that N permits. As σ_a → 0 the object's acceleration is known, and where N is
independent of the tangents α follows uniquely; as β → 0 it is the filter. All scales are physical
quantities: no norm of newtons and newton metres is taken.
"""

from __future__ import annotations

from math import sqrt

from osc_contact.law.algebra import (
    cholesky,
    cholesky_solve,
    cross,
    lu_solve,
    project_onto_constraint,
    solve_lower,
)
from osc_contact.law.energy import carry_motion, carry_wrench, energy_motion, energy_wrench
from osc_contact.law.jit import inner, leaf
from osc_contact.law.six import ZERO, add, dot6, fill, minus, plus, scaled, six

_ALONG = 0.3  #: coefficient of friction along the slip, beyond what is believed
_ACROSS = 0.1  #: and across it; the tangent of an error of the normal
_DEPARTURE = 0.1  #: σ_a (m/s²)
_LEAST_FORCE = 1.0  #: least w_j (N)
_MOST_FRICTION = 2.0  #: coefficient that is learnt at most
_NOISE = 0.01  #: of a wrist's force (N), in the metric of the object's inertia


@inner
def weigh_magnitudes(t):
    """Fill `alpha_meas` (r,); False where the weights are not positive definite."""
    work = t.work
    r = work.rank
    R = work.B
    H = work.D
    x = work.u
    f = work.reading_e
    _subtract_motion(t, f)
    _weigh_departure(t, t.model.principal[0], R)
    largest = _weigh_tangents(t, R)
    for a in range(r):
        fill(H[a], work.pushed[a])
        if work.moving != 0:
            for b in range(r):
                work.s[b] = work.Phi_mu[b, a]
            _add_yield(t, H[a])
        fill(x, scaled(largest, H[a]))
        _add_square(1.0, x, R)
    if not cholesky(R, 0, 6, work.A) > 0.0:
        return False
    gram = work.E
    right = work.K
    for a in range(r):
        y = work.solved[a]
        fill(y, H[a])
        cholesky_solve(work.A, 6, y, 0)
        right[0, a] = dot6(y, f)
        for b in range(r):
            gram[a, b] = dot6(y, H[b])
    work.weightless = 0
    if t.model.phased != 0:
        _find_mobility(t)
    if not lu_solve(gram, r, right, 1):
        return False
    for a in range(r):
        work.alpha_meas[a] = right[0, a]
        fill(f, add(f, -right[0, a], H[a]))
    return True


@inner
def _find_mobility(t):
    """`mobility` (r, r): normal acceleration for each newton that it makes these forces read.

    What is in flight accelerates by x = d(NᵀV_rel)/dt beside what contacts permit. That adds
    Λ_outN⁺x to the reading, N⁺ the motion of least kinetic energy, and (HᵀR⁻¹H)⁻¹HᵀR⁻¹Λ_outN⁺x to
    α: H and HᵀR⁻¹ are in `solved` and `E`.
    """
    work = t.work
    r = work.rank
    A = work.B
    seen = work.z
    for b in range(r):
        fill(seen, ZERO)
        for a in range(r):
            work.s[a] = 1.0 if a == b else 0.0
        _add_yield(t, seen)
        for a in range(r):
            A[a, b] = dot6(work.solved[a], seen)
    for a in range(r):  # columns of the Gram matrix, as rows
        for b in range(r):
            work.mobility[a, b] = work.E[b, a]
    if not lu_solve(A, r, work.mobility, r):
        work.weightless = 1
    for a in range(r):
        for b in range(a):
            work.mobility[a, b], work.mobility[b, a] = work.mobility[b, a], work.mobility[a, b]


@inner
def learn_friction(t):
    """Take the coefficient of friction after the tangential forces found along the slip.

    dμ/dt = k Σw_j s_jᵀβ_j / Σw_j², β_j = C_jT_jᵀR⁻¹(f − N_μα): where contacts slide, to one that
    explains them best; where they rest, s_j = 0, nothing is learnt. The factor of R and the
    residual are those that `weigh_magnitudes` left.
    """
    model = t.model
    columns = t.work.columns
    work = t.work
    if model.learning == 0.0:
        return
    y = work.reading_e
    f = work.z
    cholesky_solve(work.A, 6, y, 0)
    found = whole = 0.0
    for j in range(work.count):
        chosen = columns[j].chosen
        p = columns[chosen].point
        s = columns[chosen].slip
        w = max(abs(t.work.goal[chosen]), _LEAST_FORCE)
        for i in range(3):
            f[i] = s[i]
        f[3], f[4], f[5] = cross(p[0], p[1], p[2], s[0], s[1], s[2])
        _push_on(t, f, chosen)
        share = (_ALONG**2 - _ACROSS**2) * (s[0] ** 2 + s[1] ** 2 + s[2] ** 2) + _ACROSS**2
        found += w**3 * share * dot6(f, y)
        whole += w * w
    more = work.more_friction + model.learning * work.dt * found / whole
    work.more_friction = min(max(more, -model.mu), _MOST_FRICTION - model.mu)


@inner
def _outboard(t, x, out):
    """out = Λ_out x, energy coordinates."""
    y = scaled(x[0], t.work.out_T[0])
    for j in range(1, 6):
        y = add(y, x[j], t.work.out_T[j])
    fill(out, y)


@inner
def _subtract_motion(t, f):
    """f less Λ_out a, a the wanted acceleration as far as the contacts permit it."""
    work = t.work
    a = work.y
    V = work.V_O
    r = work.rank
    fill(a, work.A_D)
    x, y, z = cross(V[3], V[4], V[5], V[0], V[1], V[2])
    a[0], a[1], a[2] = a[0] - x, a[1] - y, a[2] - z
    carry_motion(a, work.O, work.C, a)
    energy_motion(work.axes, a, a)
    for b in range(r):
        work.s[b] = work.n_gamma[b] + work.b_N[b]
    solve_lower(work.L, r, work.s)
    project_onto_constraint(work.Q, r, a, work.s)
    _outboard(t, a, work.z)
    fill(f, minus(f, work.z))


@inner
def _weigh_departure(t, mass, R):
    """R = σ_a²m Λ_out(1 − QᵀQ)Λ_outᵀ and the noise of the wrists."""
    work = t.work
    share = _DEPARTURE * _DEPARTURE * mass
    L = work.out_T
    x = work.z
    for i in range(6):
        y = scaled(L[0, i], L[0])
        for k in range(1, 6):
            y = add(y, L[k, i], L[k])
        fill(R[i], scaled(share, y))
        R[i, i] += _NOISE * _NOISE / mass
    for a in range(work.rank):
        _outboard(t, work.Q[a], x)
        _add_square(-share, x, R)


@inner
def _weigh_tangents(t, R):
    """Add ΣT_jC_jT_jᵀ to R; returns the largest w_j.

    C_j = w_j²(σ_t²(1 − nnᵀ) + (σ_s² − σ_t²) ssᵀ), s the direction of slip, shorter than 1 where
    the contact hardly slides.
    """
    columns = t.work.columns
    work = t.work
    f = work.z
    n = work.w
    largest = 0.0
    more = sqrt(_ALONG * _ALONG - _ACROSS * _ACROSS)
    for j in range(work.count):
        chosen = columns[j].chosen
        column = columns[chosen]
        w = max(abs(t.work.goal[chosen]), _LEAST_FORCE)
        largest = max(largest, w)
        size = sqrt(column.N[0] ** 2 + column.N[1] ** 2 + column.N[2] ** 2)
        for i in range(3):
            n[i] = column.N[i] / size
        for k in range(4):
            scale = w * (_ACROSS if k < 3 else more)
            for i in range(3):
                f[i] = scale * ((1.0 if i == k else 0.0) - n[k] * n[i] if k < 3 else column.slip[i])
            p = column.point
            f[3], f[4], f[5] = cross(p[0], p[1], p[2], f[0], f[1], f[2])
            _push_on(t, f, chosen)
            _add_square(1.0, f, R)
    return largest


@inner
def _push_on(t, f, chosen):
    """A wrench f at O of one contact into energy coordinates, with what its body yields to it."""
    work = t.work
    if work.moving != 0:
        _yield_to(t, f, t.model.bodies[t.model.columns[chosen].contact].same)
    carry_wrench(f, work.O, work.C, f)
    energy_wrench(work.axes, f, f)
    if work.moving != 0:
        _add_yield(t, f)


@inner
def _yield_to(t, f, body):
    """s (r,) = NᵀΦ_e f of a wrench at O on one body."""
    work = t.work
    for a in range(work.rank):
        other = t.work.columns[int(work.keep[a])].chosen
        work.s[a] = 0.0
        if t.model.bodies[t.model.columns[other].contact].same == body:
            work.s[a] = dot6(work.yields[a], f)


@inner
def _add_yield(t, f):
    """f more Λ_out times the least motion with the normal acceleration s (r,): a body yields."""
    work = t.work
    a = work.y
    out = work.x
    solve_lower(work.L, work.rank, work.s)
    for i in range(6):
        a[i] = 0.0
        for b in range(work.rank):
            a[i] += work.Q[b, i] * work.s[b]
    _outboard(t, a, out)
    fill(f, plus(f, out))


@leaf
def _add_square(scale, x, R):
    """R + scale x xᵀ."""
    y = six(x)
    fill(R[0], add(six(R[0]), scale * y[0], y))
    fill(R[1], add(six(R[1]), scale * y[1], y))
    fill(R[2], add(six(R[2]), scale * y[2], y))
    fill(R[3], add(six(R[3]), scale * y[3], y))
    fill(R[4], add(six(R[4]), scale * y[4], y))
    fill(R[5], add(six(R[5]), scale * y[5], y))
