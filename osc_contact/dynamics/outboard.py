"""What a wrist sensor weighs besides the object: the links outboard of it (paper, fig. 5)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from osc_contact.spatial import Array, carry_twist

__all__ = ["OutboardLink", "columns_at", "outboard_links"]


@dataclass(frozen=True)
class OutboardLink:
    """A rigid part beyond the sensor: the joint it moves with, its inertia in that frame."""

    joint: int
    inertia: pin.Inertia


def outboard_links(model: pin.Model, sensor: int, tip: int) -> list[OutboardLink]:
    """The parts between the sensor frame and the object, from the model's own link inertias.

    Links welded to the sensor's link share its joint; links beyond further joints carry the
    inertia of those joints.

    Args:
        model: merged model.
        sensor: frame index of the wrist sensor (the first link outboard of the sensing element).
        tip: frame index of the grasping frame, which tells the chain.
    """
    links = []
    joint = model.frames[sensor].parentJoint
    above = model.frames[sensor].parentFrame
    if model.frames[above].type == pin.FrameType.FIXED_JOINT:
        sensor = above  # Pinocchio stores a welded link's inertia with its fixed joint
    if model.frames[above].type == pin.FrameType.JOINT:
        own = model.inertias[joint].copy()  # the sensor sits at the joint: the whole link is beyond
    else:
        own = pin.Inertia.Zero()
        for f in range(model.nframes):
            frame = model.frames[f]
            if frame.parentJoint == joint and _hangs_on(model, f, sensor):
                own = own + frame.placement.act(frame.inertia)
    if own.mass > 0.0:
        links.append(OutboardLink(joint, own))
    path = list(model.supports[model.frames[tip].parentJoint])
    for j in path:
        if j > joint and joint in model.supports[j]:
            links.append(OutboardLink(j, model.inertias[j].copy()))
    return links


def _hangs_on(model: pin.Model, frame: int, ancestor: int) -> bool:
    while frame != 0:
        if frame == ancestor:
            return True
        frame = model.frames[frame].parentFrame
    return False


def columns_at(J_world: Array, O: Array) -> Array:  # noqa: E741 - the operational point
    """Jacobian columns carried from the world origin to O."""
    return carry_twist(J_world, np.zeros(3), O)
