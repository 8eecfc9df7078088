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

from osc_contact.law.algebra import cholesky, cholesky_solve, cross, lu_solve, meet, solve_lower
from osc_contact.law.energy import carry_motion, carry_wrench, energy_motion, energy_wrench
from osc_contact.law.jit import inner, leaf
from osc_contact.law.six import add, dot6, fill, scaled, six

__all__ = ["learn_friction", "weigh_magnitudes"]

_ALONG = 0.3  #: coefficient of friction along the slip, beyond what is believed
_ACROSS = 0.1  #: and across it; the tangent of an error of the normal
_DEPARTURE = 0.1  #: σ_a (m/s²)
_LEAST_FORCE = 1.0  #: least w_j (N)
_MOST_FRICTION = 2.0  #: coefficient that is learnt at most
_NOISE = 0.01  #: of a wrist's force (N), in the metric of the object's inertia


@inner
def weigh_magnitudes(chain, table, bodies, columns, work, goal):
    """Fill `alpha_meas` (r,); False where the weights are not positive definite.

    Args:
        columns: COLUMN_WORK rows of the columns in force, their points and slips known.
        goal: (n,) wanted magnitudes of all columns. work: `reading_e`, N, N_μ, Q and L filled.
    """
    r, R, H, x, f = work.rank, work.B, work.D, work.u, work.reading_e
    _subtract_motion(work, f)
    _weigh_departure(chain.principal[0], work, R)
    largest = _weigh_tangents(table, bodies, columns, work, goal, R)
    for a in range(r):
        for i in range(6):
            H[a, i] = work.pushed[a, i]
        if work.moving != 0:
            for b in range(r):
                work.s[b] = work.Phi_mu[b, a]
            _add_yield(work, H[a])
        for i in range(6):
            x[i] = largest * H[a, i]
        _add_square(1.0, x, R)
    if not cholesky(R, 0, 6, work.A) > 0.0:
        return False
    gram, right = work.E, work.K
    for a in range(r):
        y = work.solved[a]
        for i in range(6):
            y[i] = H[a, i]
        cholesky_solve(work.A, 6, y, 0)
        right[0, a] = dot6(y, f)
        for b in range(r):
            gram[a, b] = dot6(y, H[b])
    work.weightless = 0
    if chain.phased != 0:
        _find_mobility(work)
    if not lu_solve(gram, r, right, 1):
        return False
    for a in range(r):
        work.alpha_meas[a] = right[0, a]
        for i in range(6):
            f[i] -= right[0, a] * H[a, i]
    return True


@inner
def _find_mobility(work):
    """`mobility` (r, r): normal acceleration for each newton that it makes these forces read.

    What is in flight accelerates by x = d(NᵀV_rel)/dt beside what contacts permit. That adds
    Λ_outN⁺x to the reading, N⁺ the motion of least kinetic energy, and (HᵀR⁻¹H)⁻¹HᵀR⁻¹Λ_outN⁺x to
    α: H and HᵀR⁻¹ are in `solved` and `E`.
    """
    r, A, seen = work.rank, work.B, work.z
    for b in range(r):
        for i in range(6):
            seen[i] = 0.0
        for a in range(r):
            work.s[a] = 1.0 if a == b else 0.0
        _add_yield(work, seen)
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
def learn_friction(chain, table, bodies, columns, work, goal):
    """Take the coefficient of friction after the tangential forces found along the slip.

    dμ/dt = k Σw_j s_jᵀβ_j / Σw_j², β_j = C_jT_jᵀR⁻¹(f − N_μα): where contacts slide, to one that
    explains them best; where they rest, s_j = 0, nothing is learnt. The factor of R and the
    residual are those that `weigh_magnitudes` left.

    Args:
        goal: (r_all,) desired forces (N).
    """
    if chain.learning == 0.0:
        return
    y, f = work.reading_e, work.z
    cholesky_solve(work.A, 6, y, 0)
    found = whole = 0.0
    for j in range(work.count):
        chosen = columns[j].chosen
        p, s = columns[chosen].point, columns[chosen].slip
        w = max(abs(goal[chosen]), _LEAST_FORCE)
        for i in range(3):
            f[i] = s[i]
        f[3], f[4], f[5] = cross(p[0], p[1], p[2], s[0], s[1], s[2])
        _push_on(table, bodies, columns, work, f, chosen)
        share = (_ALONG**2 - _ACROSS**2) * (s[0] ** 2 + s[1] ** 2 + s[2] ** 2) + _ACROSS**2
        found += w**3 * share * dot6(f, y)
        whole += w * w
    more = work.more_friction + chain.learning * work.dt * found / whole
    work.more_friction = min(max(more, -chain.mu), _MOST_FRICTION - chain.mu)


@inner
def _outboard(work, x, out):
    """out = Λ_out x, energy coordinates."""
    y = scaled(x[0], work.out_T[0])
    for j in range(1, 6):
        y = add(y, x[j], work.out_T[j])
    fill(out, y)


@inner
def _subtract_motion(work, f):
    """f less Λ_out a, a the wanted acceleration as far as the contacts permit it."""
    a, V, r = work.y, work.V_O, work.rank
    for i in range(6):
        a[i] = work.A_D[i]
    x, y, z = cross(V[3], V[4], V[5], V[0], V[1], V[2])
    a[0], a[1], a[2] = a[0] - x, a[1] - y, a[2] - z
    carry_motion(a, work.O, work.C, a)
    energy_motion(work.axes, a, a)
    for b in range(r):
        work.s[b] = work.n_gamma[b] + work.b_N[b]
    solve_lower(work.L, r, work.s)
    meet(work.Q, r, a, work.s)
    _outboard(work, a, work.z)
    for i in range(6):
        f[i] -= work.z[i]


@inner
def _weigh_departure(mass, work, R):
    """R = σ_a²m Λ_out(1 − QᵀQ)Λ_outᵀ and the noise of the wrists."""
    share = _DEPARTURE * _DEPARTURE * mass
    L, x = work.out_T, work.z
    for i in range(6):
        y = scaled(L[0, i], L[0])
        for k in range(1, 6):
            y = add(y, L[k, i], L[k])
        fill(R[i], scaled(share, y))
        R[i, i] += _NOISE * _NOISE / mass
    for a in range(work.rank):
        _outboard(work, work.Q[a], x)
        _add_square(-share, x, R)


@inner
def _weigh_tangents(table, bodies, columns, work, goal, R):
    """Add ΣT_jC_jT_jᵀ to R; returns the largest w_j.

    C_j = w_j²(σ_t²(1 − nnᵀ) + (σ_s² − σ_t²) ssᵀ), s the direction of slip, shorter than 1 where
    the contact hardly slides.
    """
    f, n, largest = work.z, work.w, 0.0
    more = sqrt(_ALONG * _ALONG - _ACROSS * _ACROSS)
    for j in range(work.count):
        chosen = columns[j].chosen
        column = columns[chosen]
        w = max(abs(goal[chosen]), _LEAST_FORCE)
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
            _push_on(table, bodies, columns, work, f, chosen)
            _add_square(1.0, f, R)
    return largest


@inner
def _push_on(table, bodies, columns, work, f, chosen):
    """A wrench f at O of one contact into energy coordinates, with what its body yields to it."""
    if work.moving != 0:
        _yield_to(table, bodies, columns, work, f, bodies[table[chosen].contact].same)
    carry_wrench(f, work.O, work.C, f)
    energy_wrench(work.axes, f, f)
    if work.moving != 0:
        _add_yield(work, f)


@inner
def _yield_to(table, bodies, columns, work, f, body):
    """s (r,) = NᵀΦ_e f of a wrench at O on one body."""
    for a in range(work.rank):
        other = columns[int(work.keep[a])].chosen
        work.s[a] = 0.0
        if bodies[table[other].contact].same == body:
            work.s[a] = dot6(work.yields[a], f)


@inner
def _add_yield(work, f):
    """f more Λ_out times the least motion with the normal acceleration s (r,): a body yields."""
    a, out = work.y, work.x
    solve_lower(work.L, work.rank, work.s)
    for i in range(6):
        a[i] = 0.0
        for b in range(work.rank):
            a[i] += work.Q[b, i] * work.s[b]
    _outboard(work, a, out)
    for i in range(6):
        f[i] += out[i]


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
