"""What all arms lock together: the directions no motion of the object has, and σ along them."""

from __future__ import annotations

from math import sqrt

from osc_contact.kernels.compile import compiled
from osc_contact.kernels.linalg import one_sided_jacobi, qr_rows

__all__ = ["intersect"]


@compiled
def intersect(locked, count, tolerance, V, beta, diagonal, sigma):
    """Reflectors whose first m axes span the locked directions, and σ; returns m, or −1.

    Args:
        locked: (…, 7) of all arms: a unit wrench (white) and its rate c. Destroyed.
        count: number of rows.
        tolerance: two directions this near to one another (rad) count as the same.
        V: (≥ 6, 6) rows filled with Householder vectors; beta: their factors; diagonal: scratch.
        sigma: (6,) filled, white, before any reflection: Σ u c over the singular directions.
    """
    for i in range(6):
        sigma[i] = 0.0
    if count == 0:
        return 0
    one_sided_jacobi(locked, count, 6, 1)
    m = 0
    for k in range(count):
        square = 0.0
        for i in range(6):
            square += locked[k, i] * locked[k, i]
        if sqrt(square) > tolerance:
            if m == 6:
                return -1
            for i in range(6):
                sigma[i] += locked[k, i] * locked[k, 6] / square
                V[m, i] = locked[k, i]
            m += 1
    if not qr_rows(V, m, 6, diagonal, beta):
        return -1
    return m
