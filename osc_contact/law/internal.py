"""Rows of the torque allocation for internal forces: squeeze of two arms, bars of more."""

from __future__ import annotations

from math import sqrt

from osc_contact.law.arm_motion import place_point
from osc_contact.law.energy import energy_motion
from osc_contact.law.jit import inner, integers, matrix
from osc_contact.law.linkage import settable_bars
from osc_contact.law.six import dot6, reflect

__all__ = ["internal_forces", "internal_rows"]

_COINCIDE = 1e-9  #: m; grasps nearer than this have no line between them


@inner
def internal_rows(chain, arms, table, work, arm_work, joints, E, b, d, link, squeeze):
    """Rows of the commanded internal forces, and what they are to be; returns their number.

    Args:
        E: rows for the torques. b: right sides. d: rows before these. link: of the bars.
        squeeze: (bars,) commands (N).
    """
    if chain.n_arms == 2:
        line = work.line
        place_point(joints[arms[0].tip_joint], arms[0].tip, 9, work.u)
        place_point(joints[arms[1].tip_joint], arms[1].tip, 9, work.w)
        square = 0.0
        for i in range(3):
            line[i] = work.w[i] - work.u[i]
            square += line[i] * line[i]
            line[3 + i] = 0.0
        work.internal[0] = 0.0
        if square < _COINCIDE * _COINCIDE:
            return 0
        for i in range(3):
            line[i] *= 0.5 / sqrt(square)
        energy_motion(work.axes, line, line)
        offset = 0.0
        for k in range(2):
            for j in range(arms[k].first, arms[k].end):
                E[0, j] = (1.0 - 2.0 * k) * dot6(joints[j].J_bar, line)
                offset += E[0, j] * (joints[j].inertial - joints[j].rest)
        b[d] = squeeze[0] + offset
        work.internal[0] = squeeze[0]
        return 1
    if work.commanded == 0:
        return 0
    return _bar_rows(chain, arms, table, work, arm_work, joints, E, b, d, link, squeeze)


@inner
def _bar_rows(chain, arms, table, work, arm_work, joints, E, b, d, link, squeeze):
    """Rows of the settable bar forces of three arms and more."""
    n, k, bars, m = chain.n_joints, chain.n_arms, chain.n_bars, work.locked
    points = matrix(link, 0, k, 3)
    at = 3 * k
    first, end, owners = (
        integers(link, at, k), integers(link, at + k, k), integers(link, at + 2 * k, 6 * k)
    )  # fmt: skip
    at += 8 * k
    levers_of, G = matrix(link, at, n, 3), matrix(link, at + 3 * n, n, 6)
    at += 9 * n
    effort = link[at : at + n]
    carried = matrix(link, at + n, 6 * k, 3)
    at += n + 18 * k
    levers, basis = matrix(link, at, bars, n), matrix(link, at + bars * n, bars, bars)
    at += bars * (n + bars)
    root = work.axes
    locked = 0
    for i in range(k):
        place_point(joints[arms[i].tip_joint], arms[i].tip, 9, points[i])
        first[i], end[i] = arms[i].first, arms[i].end
        for c in range(arm_work[i].n_locked):  # of orthonormal wrenches that its structure carries
            u = arm_work[i].resisted[c]
            for a in range(3):
                carried[locked, a] = 0.0
                for j in range(3):
                    carried[locked, a] += root[0, j, a] * u[j] / chain.roots[0]
            owners[locked] = i
            locked += 1
    for j in range(n):
        bar = joints[j].J_bar
        effort[j] = sqrt(table[j].effort)
        for a in range(3):  # forces in world axes: L f̃
            levers_of[j, a] = 0.0
            for i in range(3):
                levers_of[j, a] += root[0, i, a] * bar[i]
        for i in range(6):
            work.u[i] = bar[i]
        reflect(work.reflectors, work.beta, m, work.u)
        for i in range(6):
            G[j, i] = work.u[i] if i >= m else 0.0
    count = settable_bars(
        k, n, points, first, end, levers_of, G, effort, carried, owners, locked, chain.tolerance,
        levers, basis, link[at:],
    )  # fmt: skip
    for e in range(count):
        side = 0.0
        for j in range(n):
            s = 0.0
            for c in range(bars):
                s += basis[c, e] * levers[c, j]
            E[e, j] = s
            side += s * (joints[j].inertial - joints[j].rest)
        for c in range(bars):
            side += basis[c, e] * squeeze[c]
        b[d + e] = side
    return count


@inner
def internal_forces(chain, work, joints, link, out):
    """Forces (bars,) between each two of three grasps and more that the joints' torques make.

    Args:
        link: of the bars. out: (bars,) for the forces (N).
    """
    n, k, bars = chain.n_joints, chain.n_arms, chain.n_bars
    levers = matrix(link, 29 * k + 10 * n, bars, n)
    for c in range(bars):
        out[c] = 0.0
        for j in range(n if work.commanded != 0 else 0):
            out[c] += levers[c, j] * (joints[j].tau - joints[j].inertial)
