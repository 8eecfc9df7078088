"""Energy coordinates of the held object: its inertia is the identity there (see the package).

`axes` (4, 3, 3) holds the four maps from world axes at C: √m Rᵀ and √I Rᵀ for motions, Rᵀ/√m and
Rᵀ/√I for wrenches, R the principal axes of the object and I its principal moments of inertia at C.
"""

from __future__ import annotations

from osc_contact.law.algebra import cross
from osc_contact.law.jit import inner, leaf


@inner
def set_axes(R, roots, axes):
    """Fill `axes` from R (3, 3) and roots = [√m, √I₁, √I₂, √I₃].

    Args:
        R: (3, 3) principal axes. roots: (4,). axes: of WORK.
    """
    for i in range(3):
        root = roots[1 + i]
        for j in range(3):
            r = R[j, i]
            axes[0, i, j] = roots[0] * r
            axes[1, i, j] = root * r
            axes[2, i, j] = r / roots[0]
            axes[3, i, j] = r / root


@leaf
def _apply(axes, k, x, first, out):
    """out[first : first + 3] = axes[k] x[first : first + 3]."""
    a = x[first]
    b = x[first + 1]
    c = x[first + 2]
    for i in range(3):  # x may be out
        out[first + i] = axes[k, i, 0] * a + axes[k, i, 1] * b + axes[k, i, 2] * c


@leaf
def energy_motion(axes, x, out):
    """x̃ = Lᵀx of a motion x (6,) at C.

    Args:
        axes: from `set_axes`. x: (6,) motion. out: (6,).
    """
    _apply(axes, 0, x, 0, out)
    _apply(axes, 1, x, 3, out)


@leaf
def energy_wrench(axes, f, out):
    """f̃ = L⁻¹f of a wrench f (6,) at C.

    Args:
        axes: from `set_axes`. f: (6,) wrench. out: (6,).
    """
    _apply(axes, 2, f, 0, out)
    _apply(axes, 3, f, 3, out)


@leaf
def _apply_transposed(axes, k, x, first, out):
    a = x[first]
    b = x[first + 1]
    c = x[first + 2]
    for i in range(3):
        out[first + i] = axes[k, 0, i] * a + axes[k, 1, i] * b + axes[k, 2, i] * c


@leaf
def world_motion(axes, x, out):
    """x = L⁻ᵀx̃ at C; out may be x.

    Args:
        axes: from `set_axes`. x: (6,) in energy coordinates. out: (6,).
    """
    _apply_transposed(axes, 2, x, 0, out)
    _apply_transposed(axes, 3, x, 3, out)


@leaf
def world_wrench(axes, f, out):
    """f = L f̃ at C; out may be f.

    Args:
        axes: from `set_axes`. f: (6,) in energy coordinates. out: (6,).
    """
    _apply_transposed(axes, 0, f, 0, out)
    _apply_transposed(axes, 1, f, 3, out)


@leaf
def carry_motion(V, start, end, out):
    """A motion carried from point to point, in place or not.

    Args:
        V: (6,) motion. start, end: (3,) points (m). out: (6,).
    """
    x, y, z = cross(V[3], V[4], V[5], end[0] - start[0], end[1] - start[1], end[2] - start[2])
    out[0], out[1], out[2] = V[0] + x, V[1] + y, V[2] + z
    out[3], out[4], out[5] = V[3], V[4], V[5]


@leaf
def carry_wrench(f, start, end, out):
    """A wrench carried from point to point, in place or not.

    Args:
        f: (6,) wrench. start, end: (3,) points (m). out: (6,).
    """
    x, y, z = cross(start[0] - end[0], start[1] - end[1], start[2] - end[2], f[0], f[1], f[2])
    out[3], out[4], out[5] = f[3] + x, f[4] + y, f[5] + z
    out[0], out[1], out[2] = f[0], f[1], f[2]
