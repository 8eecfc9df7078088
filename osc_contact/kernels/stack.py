"""Dependent columns of N: which to keep, and how the others follow (`contacts.dependence`)."""

from __future__ import annotations

from math import sqrt

from osc_contact.kernels.compile import compiled
from osc_contact.kernels.linalg import back_substitute, dot6, form_q, qr_rows

__all__ = ["stack"]

_PIVOT = 0.3
_SURE = 1e-6  # a column this long outside the others is independent of them without doubt
_GONE = 1e-12  # and one this short is not
_CONSISTENT = 1e-6
_STILL = 1e-9


@compiled
def stack(white, count, n_gamma, size, rest, keep, R, X, Z, diagonal, beta):
    """Choose independent columns; returns their number r, or −1 where the verdict is not plain.

    Args:
        white: (r_all, 6) columns of N, white. n_gamma: (r_all,).
        size: (r_all,), rest: (r_all, 6) scratch. keep: (6,) filled, ascending.
        R: (6, r_all) filled unless r = r_all: every column from the kept ones.
    """
    for j in range(count):
        square = dot6(white[j], white[j])
        if not square > 0.0:
            return -1
        size[j] = sqrt(square)
        for i in range(6):
            rest[j, i] = white[j, i] / size[j]
    rank = 0
    shortest = 1.0
    while rank < count:
        longest = 0.0
        for j in range(count):
            square = dot6(rest[j], rest[j])
            longest = max(longest, square)
        if sqrt(longest) <= _GONE:
            break
        if rank == 6:
            return -1
        shortest = sqrt(longest)
        if shortest < _SURE:
            return -1
        first = -1
        for j in range(count):
            square = dot6(rest[j], rest[j])
            if first < 0 and square >= _PIVOT * _PIVOT * longest:
                first = j
        keep[rank] = first
        rank += 1
        _remove(rest, count, first)
    if rank == count:
        for j in range(count):
            keep[j] = j
        return count
    for a in range(1, rank):
        for b in range(a, 0, -1):
            if keep[b] < keep[b - 1]:
                keep[b], keep[b - 1] = keep[b - 1], keep[b]
    _express(white, count, size, keep, rank, R, X, Z, diagonal, beta)
    if not _consistent(n_gamma, count, size, keep, rank, R):
        return -1
    return rank


@compiled
def _remove(rest, count, first):
    """Take the direction of row `first` out of every row, twice."""
    length = sqrt(dot6(rest[first], rest[first]))
    q0, q1, q2 = rest[first, 0] / length, rest[first, 1] / length, rest[first, 2] / length
    q3, q4, q5 = rest[first, 3] / length, rest[first, 4] / length, rest[first, 5] / length
    for j in range(count):
        x = rest[j]
        for _ in range(2):
            t = q0 * x[0] + q1 * x[1] + q2 * x[2] + q3 * x[3] + q4 * x[4] + q5 * x[5]
            x[0] -= t * q0
            x[1] -= t * q1
            x[2] -= t * q2
            x[3] -= t * q3
            x[4] -= t * q4
            x[5] -= t * q5
    for i in range(6):
        rest[first, i] = 0.0


@compiled
def _express(white, count, size, keep, rank, R, X, Z, diagonal, beta):
    for k in range(rank):
        for i in range(6):
            X[k, i] = white[keep[k], i] / size[keep[k]]
    qr_rows(X, rank, 6, diagonal, beta)
    form_q(X, rank, 6, beta, rank, Z)
    back_substitute(X, rank, 6, diagonal, Z)
    for k in range(rank):
        for j in range(count):
            R[k, j] = dot6(Z[k], white[j]) / size[keep[k]]
    for k in range(rank):
        for i in range(rank):
            R[i, keep[k]] = 1.0 if i == k else 0.0


@compiled
def _consistent(n_gamma, count, size, keep, rank, R):
    """n_γ = Rᵀn_γ,keep up to rounding, as `dependence.require_consistent`."""
    largest = 0.0
    for j in range(count):
        summands = abs(n_gamma[j])
        for k in range(rank):
            summands += abs(n_gamma[keep[k]] * R[k, j])
        largest = max(largest, summands / size[j])
    for j in range(count):
        implied = 0.0
        for k in range(rank):
            implied += n_gamma[keep[k]] * R[k, j]
        if abs(n_gamma[j] - implied) > max(_STILL, _CONSISTENT * size[j] * largest):
            return False
    return True
