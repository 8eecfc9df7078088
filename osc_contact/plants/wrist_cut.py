"""Where a wrist sensor cuts the exact plant's arm, and what it reads there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from osc_contact.robots import frame_id
from osc_contact.spatial import Array, cross_wrench

__all__ = ["WristCut", "wrist_cut"]


@dataclass(frozen=True)
class WristCut:
    """A cut through a link: its joint, where it sits, what stays on the arm's side."""

    joint: int
    placement: pin.SE3
    inboard: Array  # (6, 6) at the joint

    def reading(self, data: pin.Data) -> Array:
        """(6,) wrench through it, in its axes, after `pin.rnea`: the joint's, less its own side."""
        v, a = data.v[self.joint].vector, data.a_gf[self.joint].vector
        own = self.inboard @ a + cross_wrench(v, self.inboard @ v)
        wrench = data.f[self.joint].vector - own
        return np.asarray(self.placement.actInv(pin.Force(wrench)).vector)


def wrist_cut(model: pin.Model, name: str) -> WristCut:
    """The cut at the frame `name`."""
    cut = frame_id(model, name)
    frame = model.frames[cut]
    above = frame.parentFrame
    beyond = {above if model.frames[above].type == pin.FrameType.FIXED_JOINT else cut}
    inboard: Array = model.inertias[frame.parentJoint].matrix()
    if model.frames[above].type == pin.FrameType.JOINT:  # cut at the joint itself
        return WristCut(frame.parentJoint, frame.placement, np.zeros((6, 6)))
    for f, other in enumerate(model.frames):
        if other.parentFrame in beyond:
            beyond.add(f)
        if f in beyond and other.parentJoint == frame.parentJoint:
            inboard = inboard - other.placement.act(other.inertia).matrix()
    return WristCut(frame.parentJoint, frame.placement, inboard)
