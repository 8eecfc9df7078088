"""Quadratic program for torques within the motors' limits that lose least force and motion."""

from __future__ import annotations

from math import isinf, sqrt
from typing import Any

import numpy as np

from osc_contact.errors import SolverError
from osc_contact.law.algebra import (
    add_scaled,
    cholesky,
    cholesky_solve,
    dot,
    lu_solve,
    one_sided_jacobi,
)
from osc_contact.law.jit import entry, inner, local, matrix
from osc_contact.law.nested import Bytes, Nested
from osc_contact.law.refinement import refine
from osc_contact.law.vectors import ZERO, fill, six

_FLOAT = np.float64
#: Record of the quadratic program: operands, solution, and tables. Sizes of tables: a motors, k
#: contacts that must not pull, s squeeze rows, p joint motions of redundant arms, v variables and w
#: rows of the program's square root.
PROGRAM = Nested(
    np.dtype(
        [(name, np.int64) for name in ("d", "r", "k", "s", "short")]
        + [("mass", _FLOAT)]
        + [(name, _FLOAT, (6, 6)) for name in ("Lambda", "N", "pushed", "Phi_e")]
        + [(name, _FLOAT, (6,)) for name in ("alpha", "lost_force", "lost_motion")],
        align=True,
    ),
    desired="a",
    tau_max="a",
    G=("a", 6),
    share=("k", 6),
    floor="k",
    E=("s", "a"),
    carried=("s", 6),
    idle=("p", "a"),
    tau="a",
    at_limit=(np.int64, "a"),
    lost_squeeze="s",
    scale="a",  # torque of a unit of z; then motion, force and squeeze by a unit of z
    motion=("a", 6),
    force=("a", 6),
    squeeze=("s", "a"),
    H="vv",  # (v, v), f (v,), A (k, v) and bounds, in the solver's form
    f="v",
    A="kv",
    lower="vk",
    upper="vk",
    sense=(np.int32, "vk"),
    z="v",  # the solver's answer
    lam="vk",
    rows=("v", "w"),  # transposed square root of H
    point="w",
    y="w",
    diagonal="w",
    beta="w",
    bend="w",
    mix="w",
    offset="w",
    normals=("k1", "v"),
    reduced=("v", "w"),
    free=(np.int64, "v"),
)
_program = PROGRAM.at


# --- The quadratic program ------------------------------------------------------------------------
#
# With torques τ + δτ instead of τ, the chain in contact has the contact forces α + δα and the
# acceleration η̇ + δη̇ (eqs. 17, 18):
#
#     δα = D⁻¹NᵀΛ⁻¹G δτ,   δη̇ = Λ⁻¹(G δτ − N_μ δα),   D = NᵀΛ⁻¹N_μ + Φ_e
#
# Hence every δτ satisfies the contact constraints, and the loss of force and motion is predicted.
# The objective is acceleration energy (Gauss), in N²/kg: |δη̇|² of motion, |N δα|² of contact force
# (in energy coordinates the object's inertia is the identity), δs²/m_o of squeeze, and (νᵀδτ)² of
# joint motions ν of redundant arms that do not move the object, νᵀMν = 1. So metres and radians
# are not added, and lost motions of an arm near a singular posture do not dominate the objective.
#
# Columns of N may be nearly dependent. A rotation U makes the rows of UNᵀ orthogonal in the free
# motions, and ψ = Uδα solves UDUᵀψ = UNᵀΛ⁻¹G δτ, whose rows are well distinguished; only their
# magnitudes differ.

# Weights relative to that of motion, 1. Motion is given up last, because its errors accumulate.
_FORCE = 1e-3
_SQUEEZE = 1e-5
# of torques without effect on the object, relative to the mean energy of a torque
_IDLE_TORQUE_WEIGHT = 1e-7
_POSTURE = 0.1  # of joint motions without effect on the object, so that no joint whirls
_OUT_OF_RANGE_WEIGHT = 1e2  # of a force out of range when no feasible torques keep it in range
_SOLVER_INFINITY = 1e30  # the solver's infinity
_LIMIT_TOLERANCE = 1e-9  # relative tolerance of the limits, for rounding errors


@inner
def _compute_mobility(p, X, accelerations, mobility, row_maximum, factor):
    """Compute the mobility D of the contacts for rotated contact forces, U D Uᵀ.

    D = NᵀΛ⁻¹N_μ + Φ_μ (r, r; 1/kg) is the normal acceleration of the contacts per unit of their
    forces, summed over the chain and the touched bodies: N (6, r) are the wrenches of the r contact
    forces, N_μ those with their friction, Λ (6, 6) is the inertia of the chain, and Φ_μ (r, r) the
    mobility NᵀΦ_eN_μ of the touched bodies. The rotation U (r, r) makes the rows of UNᵀ orthogonal
    along the d free axes, so that nearly dependent columns of N differ in magnitude only. All are
    in energy coordinates, whose last d axes are free.

    Args:
        p: PROGRAM, of which `d`, `r`, `Lambda` (Λ), `N` (Nᵀ by rows), `pushed` (N_μᵀ by rows) and
            `Phi_e` (Φ_μ) are read.
        X: (r, 18), filled: in each row 6 elements of UNᵀ, free axes first; d of U(N_μ − N)ᵀ, free
            axes only; and r of U.
        accelerations: (r, d), filled with the rows of UN_μᵀΛ⁻¹, the acceleration of the chain along
            the free axes per unit of each rotated force.
        mobility: (r, r), filled with UDUᵀ, each row divided by its element of `row_maximum`.
        row_maximum: (r,), filled with the largest magnitude in each row of UDUᵀ.
        factor: (d, d), filled with the Cholesky factor of Λ along the free axes.

    Returns:
        False if Λ is not positive definite.
    """
    d = p.d
    r = p.r
    first_of_U = 6 + d
    for a in range(r):
        # The d free elements, which are the last ones of N, come first: `one_sided_jacobi` makes
        # the leading elements of rows orthogonal.
        for i in range(6):  # element 6 − d + i becomes element i, the locked ones follow
            X[a, (i + d) % 6] = p.N[a, i]
        for i in range(d):  # element 6 − d + i of six is free axis i
            X[a, 6 + i] = p.pushed[a, 6 - d + i] - p.N[a, 6 - d + i]
        for b in range(r):
            X[a, first_of_U + b] = 1.0 if a == b else 0.0
    # Behind the d leading elements 6 − d locked ones, d of friction and r of U are rotated, too.
    one_sided_jacobi(X, r, d, 6 + r)
    if not cholesky(p.Lambda, 6 - d, d, factor) > 0.0:  # also if NaN
        return False
    for b in range(r):
        for i in range(d):  # UN_μᵀ = UNᵀ + U(N_μ − N)ᵀ
            accelerations[b, i] = X[b, i] + X[b, 6 + i]
        cholesky_solve(factor, d, accelerations[b])
    for a in range(r):
        row_maximum[a] = 0.0
        for b in range(r):
            mobility[a, b] = dot(X[a], accelerations[b], d)
            for c in range(r):  # UΦ_μUᵀ
                mobility[a, b] += X[a, first_of_U + c] * dot(p.Phi_e[c], X[b, first_of_U:], r)
            row_maximum[a] = max(row_maximum[a], abs(mobility[a, b]))
        # Rows may differ by many powers of ten; with equal magnitudes pivots are comparable.
        for b in range(r):
            mobility[a, b] /= row_maximum[a]
    return True


@inner
def _compute_responses(p):
    """Compute the response of the object and of the contacts to each motor: δη̇ and δα.

    The torque of motor j is `scale[j]`, and its wrench g = `G[j] scale[j]`, in energy coordinates
    of which the last d axes are free. Contact forces are computed as ψ = Uδα; the rotation U makes
    the rows of UNᵀ orthogonal, so that nearly dependent contacts can be distinguished. With the
    mobility UDUᵀ (1/kg) of `_compute_mobility`,

        UDUᵀψ = UNᵀΛ⁻¹g,   δα = Uᵀψ,   δη̇ = Λ⁻¹(g − N_μδα)   (eqs. 17, 18)

    Reads `G`, `Lambda` (Λ), `N`, `pushed` (N_μ), `Phi_e` and `scale`. Fills `motion` (a, 6), δη̇
    (energy coordinates) along the d free axes; `force` (a, 6), δα (N) of the r columns; and the
    first 6 + d elements of each row of `rows`, residuals of the least-squares program: δη̇ (d),
    then √`_FORCE` N δα (6).

    Args:
        p: PROGRAM.

    Returns:
        False if Λ or the mobility of the contacts is singular.
    """
    d = p.d
    r = p.r
    n_motors = len(p.scale)
    X = local(6, 18)  # each row: UNᵀ (6, the d free axes first), U(N_μ − N)ᵀ (d), U (r)
    accelerations = local(6, 6)  # rows of UN_μᵀΛ⁻¹
    mobility = local(6, 6)
    row_maximum = local(6)
    factor = local(6, 6)
    if not _compute_mobility(p, X, accelerations, mobility, row_maximum, factor):
        return False
    for j in range(n_motors):
        for i in range(d):
            p.motion[j, i] = p.G[j, 6 - d + i] * p.scale[j]
        cholesky_solve(factor, d, p.motion[j])  # Λ⁻¹g, the motion without contacts
        for a in range(r):  # the rows of `mobility` are divided by the same numbers
            p.force[j, a] = dot(X[a], p.motion[j], d) / row_maximum[a]
    if not lu_solve(mobility, r, p.force, n_motors):
        return False
    for j in range(n_motors):
        motion = p.motion[j]
        force = p.force[j]
        row = p.rows[j]
        row[:] = 0.0
        psi = six(force)  # copied, since `force` becomes δα = Uᵀψ
        fill(force, ZERO)
        for a in range(r):
            add_scaled(-psi[a], accelerations[a], d, motion)  # δη̇ −= Λ⁻¹N_μUᵀψ
            add_scaled(psi[a], X[a, 6 + d :], r, force)  # δα = Uᵀψ
            add_scaled(sqrt(_FORCE) * psi[a], X[a], 6, row[d:])  # N δα = (UNᵀ)ᵀψ
        add_scaled(1.0, motion, d, row)
    return True


@entry
def prepare(raw, slack):
    """Fill the program min |rowsᵀz|² with lower ≤ (z, Az) ≤ upper, z = (δτ/scale, slack).

    z (v,) has the n_a changes of torques δτ in units of `scale`, then the slack variables. Each of
    the v rows of `rows` has the roots of the energies that one variable causes: of motion and force
    (`_compute_responses`), squeeze, joint motions of redundant arms, and, on a diagonal, of each
    variable itself. H = rows rowsᵀ (v, v) is the Hessian; the k rows of A (k, v) are the sums of
    variables that the contact forces depend on. Reads all operands; fills `rows`, `H`, `A`,
    `lower`, `upper` (v bounds of z, then k of Az) and the fields of `_scale_torques`,
    `_compute_responses`, `_add_energies`.

    Args:
        raw: bytes of PROGRAM.
        slack: number of slack variables: 0, or k, if the k forces may leave their ranges at a cost.

    Returns:
        False if the response of the chain to the motors is singular.
    """
    p = _program(raw, 0)
    n = len(p.scale)
    v = n + slack
    rows = p.rows
    H = matrix(p.H, 0, v, v)
    w = 6 + p.d + p.s + len(p.idle)  # elements of a row before the diagonal
    _scale_torques(p)
    if not _compute_responses(p):
        return False
    energy = _add_energies(p, w)
    # Energies relative to their mean over the motors: then H has elements of about 1.
    size = sqrt(energy / n) if energy > 0.0 else 1.0
    for j in range(v):
        # of a torque or a slack variable itself
        weight = _IDLE_TORQUE_WEIGHT if j < n else _OUT_OF_RANGE_WEIGHT
        for i in range(w):
            rows[j, i] = rows[j, i] / size if j < n else 0.0
        for i in range(v):  # the diagonal behind the energies
            rows[j, w + i] = sqrt(weight) if i == j else 0.0
        for i in range(j + 1):
            H[i, j] = H[j, i] = dot(rows[i], rows[j], w + v)
    _bound_contacts(p, slack)
    return True


@inner
def _scale_torques(p):
    """Fill `scale` (a,), the torque of a unit of z (N m, N), and the bounds of z for the motors.

    The scale of a motor is its limit; that of a motor without a limit is the largest limit, or 1.
    Reads `tau_max` and `desired` (a,); fills the first a elements of `lower` and `upper`, too, with
    the bounds (±tau_max − desired)/scale.

    Args:
        p: PROGRAM.
    """
    tau_max = p.tau_max
    scale = p.scale
    largest = 0.0
    for j in range(len(scale)):
        if not isinf(tau_max[j]):
            largest = max(largest, tau_max[j])
    largest = largest if largest > 0.0 else 1.0
    for j in range(len(scale)):
        scale[j] = min(tau_max[j], largest)
        p.lower[j] = max((-tau_max[j] - p.desired[j]) / scale[j], -_SOLVER_INFINITY)
        p.upper[j] = min((tau_max[j] - p.desired[j]) / scale[j], _SOLVER_INFINITY)


@inner
def _add_energies(p, w):
    """Fill the roots of the energies of squeeze and of redundant joint motions in `rows`.

    z (v,) are the variables of the program; a unit of one of the first a is `scale` of one motor's
    torque. Its squeeze (N) is E scale, with E (s, a), less the squeeze that goes into the inertial
    forces of the motion that it causes, `carried` (s, 6) times `motion` (a, 6); its energy is
    squeeze²/mass. Its joint motion νᵀδτ of a redundant arm has the energy (νᵀδτ)², with ν (a,) in
    the rows of `idle`. The energies have the weights `_SQUEEZE` and `_POSTURE`. Fills `squeeze` (s,
    a), and the elements of `rows` behind those of `_compute_responses`.

    Args:
        p: PROGRAM after `_compute_responses`.
        w: number of elements of a row that are energies.

    Returns:
        Sum of the energies that units of all torques cause (N²/kg).
    """
    rows = p.rows
    begin = 6 + p.d  # behind the elements of `_compute_responses`
    energy = 0.0
    for j in range(len(p.scale)):
        for c in range(p.s):  # `motion` begins with the d free axes, `carried` ends with them
            inertial = dot(p.carried[c, 6 - p.d :], p.motion[j], p.d)
            p.squeeze[c, j] = p.E[c, j] * p.scale[j] - inertial
            rows[j, begin + c] = sqrt(_SQUEEZE / p.mass) * p.squeeze[c, j]
        for c in range(len(p.idle)):
            rows[j, begin + p.s + c] = sqrt(_POSTURE) * p.idle[c, j] * p.scale[j]
        energy += dot(rows[j], rows[j], w)
    return energy


@inner
def _bound_contacts(p, slack):
    """Fill A and the bounds of the contact forces that must not pull, and of the slack variables.

    Row c of A (k, v) is the change of the c-th such force per unit of each variable of z (v,),
    divided by its norm. The force may fall from its command to its floor, and must not rise. Its
    slack variable, if there is one, has the coefficient 1 and no bounds. Reads `share` (k, 6; the
    forces as combinations of the r contact forces), `force` (a, 6; change of these by a unit of z),
    `floor` (k,) and `alpha` (6,; commands), both in N. Fills `A`, and in `lower` and `upper` the
    bounds of the slack variables and, from element v on, of A z.

    Args:
        p: PROGRAM after `_compute_responses`.
        slack: number of slack variables, 0 or k.
    """
    lower = p.lower
    upper = p.upper
    n = len(p.scale)
    v = n + slack
    A = matrix(p.A, 0, p.k, v)
    for c in range(p.k):
        for j in range(v):
            A[c, j] = dot(p.share[c], p.force[j], p.r) if j < n else 0.0
        norm = sqrt(dot(A[c], A[c], n))
        norm = norm if norm > 0.0 else 1.0
        for j in range(n):
            A[c, j] /= norm
        if slack > 0:
            A[c, n + c] = 1.0
            lower[n + c] = -_SOLVER_INFINITY
            upper[n + c] = _SOLVER_INFINITY
        lower[v + c] = min((p.floor[c] - dot(p.share[c], p.alpha, p.r)) / norm, 0.0)
        upper[v + c] = 0.0  # no contact presses harder than commanded


@entry
def finish(raw, slack):
    """Compute torques from the solver's answer, and the losses that they cause.

    Reads `z` (v,), the changes of torques in units of `scale`, then the slack variables, and `lam`
    (v + k,), the multipliers of their bounds and of the bounds of A z. Fills `tau` (a,; N m, N) and
    `at_limit` (a,; 1 at a limit); the commanded less the resulting values of contact forces
    `lost_force` (r,; N), motion `lost_motion` (6,; energy coordinates, d free axes last) and
    internal forces `lost_squeeze` (s,; N); and `short`, 1 if a force leaves its range.

    Args:
        raw: bytes of PROGRAM.
        slack: number of slack variables, as in `prepare`.

    Returns:
        Whether the torques are finite.
    """
    p = _program(raw, 0)
    z = p.z
    n = len(p.scale)
    p.short = slack > 0
    if refine(p, slack):  # the same solution, computed more accurately
        for j in range(n + slack):
            z[j] = p.point[j]
    fill(p.lost_force, ZERO)
    fill(p.lost_motion, ZERO)
    for j in range(n):
        if not abs(z[j]) < _SOLVER_INFINITY:  # also if NaN
            return False
        limit = p.tau_max[j]
        p.tau[j] = max(-limit, min(limit, p.desired[j] + p.scale[j] * z[j]))
        p.at_limit[j] = abs(p.tau[j]) >= limit * (1.0 - _LIMIT_TOLERANCE)
        add_scaled(-z[j], p.force[j], p.r, p.lost_force)
        add_scaled(-z[j], p.motion[j], p.d, p.lost_motion[6 - p.d :])
    for c in range(p.s):
        p.lost_squeeze[c] = -dot(p.squeeze[c], z, n)
    return True


class TorqueLimits:
    """Solver for torques within the motors' limits.

    Fill the arrays of PROGRAM in place, then call `solve`. Motions and wrenches are in energy
    coordinates, turned so that the last d axes are free; torques in N m (N), forces in N.

    Attributes:
        raw: bytes of PROGRAM, whose fields are attributes of this object, too.
        d, r, k, s: numbers of free motions, of contact forces, of forces among them that must not
            pull, and of squeeze rows in use.
        desired, tau_max: (n_a,) desired torques; limits (inf: none).
        G: (n_a, 6) wrench on the object per unit of each motor's torque.
        Lambda: (6, 6) inertia of the chain.
        mass: of the object (kg).
        N, pushed: (6, 6) columns of N and, with friction, N_μ as rows.
        Phi_e: (6, 6) NᵀΦ_eN_μ.
        alpha: (6,) force command.
        share: (k_max, 6) forces that must not pull, as combinations of α.
        floor: (k_max,) their least values, not larger than the commanded ones.
        E: (s_max, n_a) rows of the squeeze.
        carried: (s_max, 6) squeeze by the inertial forces of a motion.
        idle: (p, n_a) joint motions ν of redundant arms, νᵀMν = 1, restricted to their motors.
        tau: (n_a,) resulting torques.
        at_limit: (n_a,) 1 for each motor at its limit.
        lost_force: (6,), lost_motion: (6,), lost_squeeze: (s_max,) commanded less resulting values;
            zero beyond r, and in locked axes.
    """

    def __init__(self, n_a: int, k_max: int, s_max: int, p: int = 0) -> None:
        """Allocate the record for the largest numbers, and solve once so that all is compiled.

        Args:
            n_a: largest number of motors.
            k_max: largest number of contacts that must not pull.
            s_max: largest number of squeeze rows.
            p: largest number of joint motions of redundant arms.
        """
        v = n_a + k_max  # variables: torques and slack variables
        w = 12 + s_max + p + v + k_max  # energies of motion, force, squeeze, … of one variable
        # letters of sizes in the declaration of PROGRAM
        counts = {"a": n_a, "k": k_max, "s": s_max, "p": p, "v": v, "w": w, "k1": k_max + 1}
        self.__setstate__(PROGRAM.new({**counts, "vv": v * v, "kv": k_max * v, "vk": v + k_max}))
        self.program.mass = 1.0
        self.program.tau_max[:] = np.inf
        self.solve()  # no tick has to wait until this is compiled

    def __getattr__(self, name: str) -> Any:
        """Return a field of PROGRAM, such as `tau`, as an attribute of this object.

        Args:
            name: name of the field.
        """
        if name in ("raw", "program"):  # not made yet
            raise AttributeError(name)
        return getattr(self.program, name)

    def solve(self) -> bool:
        """Find the torques within the limits with the least loss of acceleration energy.

        Returns:
            True if a contact force leaves its range because no feasible torques keep it there.

        Raises:
            SolverError: the program could not be solved.
        """
        import daqp

        p = self.program
        k = int(p.k)
        for slack in (0, k):  # slack variables only if the ranges of forces cannot be kept
            v = len(p.tau) + slack
            end = v + k
            if not prepare(self.raw, slack):
                break
            z, _, verdict, info = daqp.solve(
                p.H[: v * v].reshape(v, v),
                p.f[:v],
                p.A[: k * v].reshape(k, v),
                p.upper[:end],
                p.lower[:end],
                p.sense[:end],
                primal_tol=1e-10,
            )
            if verdict <= 0:
                continue
            p.z[:v] = z
            p.lam[:end] = info["lam"]
            if finish(self.raw, slack):
                return slack > 0
        raise SolverError(
            f"no torques within the motor limits were found for {np.round(self.desired, 3)} desired"
        )

    def __getstate__(self) -> Bytes:
        """Return the bytes of PROGRAM for pickle: views of them cannot be copied."""
        return self.raw

    def __setstate__(self, raw: Bytes) -> None:
        """Set the program from a copy of its bytes.

        Args:
            raw: bytes of PROGRAM.
        """
        self.raw = raw.copy()
        self.program = PROGRAM.view(self.raw)
