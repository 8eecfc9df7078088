"""Rows of the torque allocation for internal forces: squeeze of two arms, bars of more."""

from __future__ import annotations

from math import sqrt

from osc_contact.law.arm_motion import place_point
from osc_contact.law.energy import energy_motion
from osc_contact.law.jit import inner
from osc_contact.law.linkage import settable_bars
from osc_contact.law.six import dot6, fill, reflect

_COINCIDE = 1e-9  #: m; grasps nearer than this have no line between them


@inner
def internal_rows(t, d):
    """Rows of the commanded internal forces, and what they are to be; returns their number.

    Args:
        d: rows before these.
    """
    arms = t.model.arms
    work = t.work
    joints = t.work.joints
    E = t.work.extra
    squeeze = t.memory.squeeze
    if t.model.n_arms == 2:
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
        t.work.sides[d] = squeeze[0] + offset
        work.internal[0] = squeeze[0]
        return 1
    if work.commanded == 0:
        return 0
    return _bar_rows(t, d)


@inner
def _bar_rows(t, d):
    """Rows of the settable bar forces of three arms and more."""
    model = t.model
    arms = model.arms
    work = t.work
    arm_work = t.work.arms
    joints = t.work.joints
    n = model.n_joints
    k = model.n_arms
    bars = model.n_bars
    m = work.locked
    force_levers = work.force_levers
    carried = work.carried
    basis = work.basis
    root = work.axes
    locked = 0
    for i in range(k):
        place_point(joints[arms[i].tip_joint], arms[i].tip, 9, work.points[i])
        for c in range(arm_work[i].n_locked):  # of orthonormal wrenches that its structure carries
            u = arm_work[i].resisted[c]
            for a in range(3):
                carried[locked, a] = 0.0
                for j in range(3):
                    carried[locked, a] += root[0, j, a] * u[j] / model.roots[0]
            work.owners[locked] = i
            locked += 1
    for j in range(n):
        bar = joints[j].J_bar
        work.efforts[j] = sqrt(model.joints[j].effort)
        for a in range(3):  # forces in world axes: L f̃
            force_levers[j, a] = 0.0
            for i in range(3):
                force_levers[j, a] += root[0, i, a] * bar[i]
        fill(work.u, bar)
        reflect(work.reflectors, work.beta, m, work.u)
        for i in range(6):
            work.driven[j, i] = work.u[i] if i >= m else 0.0
    count = settable_bars(t, locked)
    for e in range(count):
        side = 0.0
        for j in range(n):
            s = 0.0
            for c in range(bars):
                s += basis[c, e] * work.levers[c, j]
            work.extra[e, j] = s
            side += s * (joints[j].inertial - joints[j].rest)
        for c in range(bars):
            side += basis[c, e] * t.memory.squeeze[c]
        work.sides[d + e] = side
    return count


@inner
def internal_forces(t):
    """Forces (bars,) between each two of three grasps and more that the joints' torques make."""
    joints = t.work.joints
    out = t.work.bars
    n = t.model.n_joints
    bars = t.model.n_bars
    for c in range(bars):
        out[c] = 0.0
        for j in range(n if t.work.commanded != 0 else 0):
            out[c] += t.work.levers[c, j] * (joints[j].tau - joints[j].inertial)
