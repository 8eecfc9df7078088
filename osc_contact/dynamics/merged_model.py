"""Merged model of several arms, and rigid parts of an arm beyond its wrist sensor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from osc_contact.dynamics.arm import Arm, rotor_inertia, with_distinct_frames
from osc_contact.errors import InvalidInputError


def merge(arms: Sequence[Arm]) -> pin.Model:
    """Merge the models of all arms at their bases; joints and frames are named "arm/name".

    Args:
        arms: arms, in the order of their joints in the merged model.

    Raises:
        InvalidInputError: a joint has more position numbers than velocities.
    """
    merged_model = pin.Model()
    rotor_inertias = []
    names: dict[str, str] = {}
    merged_model.gravity = arms[0].model.gravity
    for arm in arms:
        model = arm.model.copy()
        for j in range(1, model.njoints):
            model.names[j] = f"{arm.name}/{model.names[j]}"
        for frame in list(model.frames)[1:]:
            frame.name = f"{arm.name}/{frame.name}"
        names |= with_distinct_frames(model)
        merged_model = pin.appendModel(merged_model, model, 0, arm.base)
        rotor_inertias.append(rotor_inertia(model))
    for frame in merged_model.frames:
        frame.name = names[frame.name]
    merged_model.armature = np.concatenate(rotor_inertias)  # appendModel of Pinocchio 4.1 omits it
    if merged_model.nq != merged_model.nv:
        raise InvalidInputError(
            "joints with nq ≠ nv are not supported; robots.load_model makes continuous joints "
            "revolute ones without end stops"
        )
    return merged_model


@dataclass(frozen=True)
class OutboardLink:
    """Rigid part of an arm beyond its wrist sensor.

    Attributes:
        joint: number of the joint in the model that moves the part.
        inertia: inertia in the frame of that joint.
    """

    joint: int
    inertia: pin.Inertia


def outboard_links(model: pin.Model, sensor: int, tip: int) -> list[OutboardLink]:
    """List the rigid parts between a wrist sensor and the object, with their inertias.

    Links that are welded to the sensor's link form one part, with the sensor's joint; each further
    joint gives one part.

    Args:
        model: merged model.
        sensor: frame index of the wrist sensor (the first link outboard of the sensing element).
        tip: frame index of the grasping frame, which identifies the arm's chain.
    """
    links = []
    joint = model.frames[sensor].parentJoint
    above = model.frames[sensor].parentFrame
    if model.frames[above].type == pin.FrameType.FIXED_JOINT:
        sensor = above  # Pinocchio stores a welded link's inertia with its fixed joint
    if model.frames[above].type == pin.FrameType.JOINT:
        inertia = model.inertias[joint].copy()  # the sensor is at the joint: the whole link
    else:
        inertia = pin.Inertia.Zero()
        outboard_frames = {sensor}
        for f, frame in enumerate(model.frames):
            if frame.parentFrame in outboard_frames:  # parents have smaller indices
                outboard_frames.add(f)
            if f in outboard_frames and frame.parentJoint == joint:
                inertia = inertia + frame.placement.act(frame.inertia)
    if inertia.mass > 0.0:
        links.append(OutboardLink(joint, inertia))
    path = list(model.supports[model.frames[tip].parentJoint])
    outer = [j for j in path if j > joint and joint in model.supports[j]]
    return links + [OutboardLink(j, model.inertias[j].copy()) for j in outer]
