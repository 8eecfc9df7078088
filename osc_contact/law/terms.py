"""Λ, μ, p, J, J̄, Φ and h of one arm at its tip in world axes, without a tick around them."""

from __future__ import annotations

from math import isfinite

from osc_contact.law.arm_motion import move_arm, place_arm, place_point, weight_on_joint
from osc_contact.law.jit import entry, inner
from osc_contact.law.operational import arm_terms, weigh_joints
from osc_contact.law.records import row_of
from osc_contact.law.vectors import (
    ZERO,
    accumulate,
    add,
    cross,
    dot6,
    fill3,
    finiteness,
    plus3,
)


@entry
def operational_space(raw, q, v, out):
    """Fill out (rows, size); returns how many rows were done before one that cannot be.

    A row holds Λ, Φ, J, J̄, μ, p, J̇v, h and the rank one after the other, matrices by rows.

    Args:
        raw: bytes of `records.Rows` with one arm alone. q, v: (rows · n,). out: (rows, size).
    """
    t = row_of(raw, 0, 0)
    n = t.model.n_joints
    if len(q) != n * len(out) or len(v) != len(q):
        return 0
    for row in range(len(out)):
        first = row * n
        s = finiteness(q[first:], n) + finiteness(v[first:], n)
        if not isfinite(s) or not _arm_at_tip(t, n, q[first:], v[first:], out[row]):
            return row
    return len(out)


@inner
def _arm_at_tip(t, n, q, v, out):
    """One row; False: M is not definite.

    Ranks are judged in energy coordinates, as everywhere: those of the object, or of what stands
    for it, here with its principal axes along the world's.
    """
    model = t.model
    work = t.work
    joints = work.joints
    arm = model.arms[0]
    own = work.arms[0]
    drift = own.drift
    root = work.z
    mu = ZERO
    p = ZERO
    place_arm(t, 0, n, q)
    fill3(work.C, place_point(joints[arm.tip_joint], arm.tip[9:]))
    move_arm(t, arm, v, work.C, own.V, drift, own.bias)
    fill3(drift, plus3(drift, cross(own.V[3:], own.V)))  # the rate of J q̇, no spatial acceleration
    for i in range(3):
        root[i] = model.roots[0]
        root[3 + i] = model.roots[1 + i]
    for j in range(n):
        for i in range(6):
            joints[j].J[i] = root[i] * joints[j].column[i]
    if arm_terms(t, 0, n, 6, own, 0) < 0:
        return False
    weigh_joints(0, n, joints, work.K, work.Z)
    work.A[:] = 0.0
    for j in range(n):
        bar = joints[j].J_bar
        Z = work.Z[j]
        for a in range(6):
            bar[a] *= root[a]
            accumulate(work.A[a], Z[a], Z)
        g = weight_on_joint(joints[j], model.gravity)
        p = add(p, g, bar)
        mu = add(mu, joints[j].h - g, bar)
    at = 12 * n + 72  # behind all matrices
    for a in range(6):
        row = own.Lambda[a]
        for b in range(6):
            row[b] *= root[a] * root[b]
            out[6 * a + b] = row[b]
            out[36 + 6 * a + b] = work.A[a, b] / (root[a] * root[b])
        for j in range(n):
            out[72 + a * n + j] = joints[j].column[a]
            out[72 + 6 * (n + j) + a] = joints[j].J_bar[a]
        out[at + a] = mu[a] - dot6(row, drift)
        out[at + 6 + a] = p[a]
        out[at + 12 + a] = drift[a]
    for j in range(n):
        out[at + 18 + j] = joints[j].h
    out[at + 18 + n] = own.n_kept
    return True
