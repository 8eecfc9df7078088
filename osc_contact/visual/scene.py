"""The moving three-dimensional picture of a recording: arms, object, faces, contact forces.

Per contact: the line of force through the contact point, an arrow of changing length whose tip
touches the contact point and that shows the true force f_c pushing INTO the face, and around it a
wider, paler arrow for the desired force. Contacts that are open show neither line nor arrow.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from osc_contact.errors import InvalidInputError
from osc_contact.robots import load_geometry
from osc_contact.visual import contact_colour
from osc_contact.visual.page import CommandSink, write_page
from osc_contact.visual.primitives import (
    along,
    arrow,
    arrow_lengths,
    line_of_force,
    move,
    track,
    urdf_geometry,
)
from osc_contact.visual.stage import set_stage

if TYPE_CHECKING:
    from meshcat import Visualizer
    from meshcat.animation import Animation

    from osc_contact.recorder import Recording

__all__ = ["ArmVisual", "BodyVisual", "write_scene"]

ARROW_METRES_PER_NEWTON = 0.01
LINE_OF_FORCE_LENGTH = 0.7
Array = NDArray[np.float64]


class ArmVisual(NamedTuple):
    """An arm to draw: its URDF, where its base stands (X_WB), where its joints are in q."""

    name: str
    urdf: str | Path
    package_dirs: Sequence[str | Path]
    base: pin.SE3
    q_slice: slice


class BodyVisual(NamedTuple):
    """A body to draw: fixed at the placement (X_WB), or moving with the object when None."""

    name: str
    urdf: str | Path
    package_dirs: Sequence[str | Path]
    placement: pin.SE3 | None


def write_scene(
    recording: Recording,
    arms: Sequence[ArmVisual],
    bodies: Sequence[BodyVisual],
    path: str | Path,
    fps: int = 30,
) -> Path:
    """Write the recording as an HTML page that plays by itself, again and again.

    Args:
        recording: needs ``t``; draws from ``q``, ``pose`` and the contact channels what is there.
        arms: the arms, moved by ``q``.
        bodies: fixed bodies and the object (placement None), moved by ``pose``.
        path: the page to write.
        fps: key frames per second.

    Returns:
        The path written.

    Raises:
        InvalidInputError: no ticks, fps < 1, a channel that a body needs is missing, or an arm's
            slice of q does not fit its URDF.
    """
    t = np.asarray(recording.channels["t"], dtype=float)
    if t.size == 0 or fps < 1:
        raise InvalidInputError(f"{t.size} ticks at {fps} frames/s make no picture: both need >= 1")
    times = np.arange(int(np.floor((t[-1] - t[0]) * fps + 1e-9)) + 1) / fps
    ticks = np.minimum(np.searchsorted(t - t[0], times - 1e-9), t.size - 1)
    channels = {key: np.asarray(value)[ticks] for key, value in recording.channels.items()}
    sink = CommandSink()
    scene = sink.visualizer()
    from meshcat.animation import Animation

    animation = Animation(default_framerate=fps)
    points = [_draw_arm(scene["arms"][arm.name], animation, arm, channels) for arm in arms]
    points += [_draw_body(scene["bodies"][b.name], animation, b, channels) for b in bodies]
    anchors = [arm.base.translation for arm in arms] or [np.zeros(3)]
    names = [str(name) for name in recording.meta.get("contact_names", [])]
    contacts = names if "contact_point" in channels and "contact_direction" in channels else []
    for index, name in enumerate(contacts):
        _draw_contact(scene["contacts"][name], animation, index, channels)
    set_stage(
        scene,
        np.vstack([*points, *anchors]),
        np.array([arm.base.translation for arm in arms]).reshape(-1, 3),
        channels.get("contact_direction"),
    )
    scene.set_animation(animation, play=True, repetitions=float("inf"))
    legend = [
        (contact_colour(i), f"force applied at {name} (wide, pale: desired)")
        for i, name in enumerate(contacts)
    ]
    scenario = recording.meta.get("scenario", {})
    title = scenario.get("name", "recording") if isinstance(scenario, dict) else "recording"
    return write_page(sink, path, str(title).replace("_", " "), legend)


def _channel(channels: dict[str, Any], key: str, needed_by: str) -> Array:
    if key not in channels:
        raise InvalidInputError(f"{needed_by} moves with the channel {key!r}: it is not recorded")
    return np.asarray(channels[key], dtype=float)


def _draw_arm(
    node: Visualizer, animation: Animation, arm: ArmVisual, channels: dict[str, Any]
) -> Array:
    """Draw the arm; return the points (world) that the camera shall see."""
    model, geometry, _ = load_geometry(arm.urdf, pin.GeometryType.VISUAL, arm.package_dirs)
    shapes = list(geometry.geometryObjects)
    q = _channel(channels, "q", f"arm {arm.name!r}")[:, arm.q_slice]
    if q.shape[1] != model.nq:
        raise InvalidInputError(
            f"arm {arm.name!r}: {arm.q_slice} takes {q.shape[1]} numbers of q, "
            f"but {arm.urdf} has nq = {model.nq}"
        )
    joints = sorted({shape.parentJoint for shape in shapes})
    nodes = {joint: node[model.names[joint] if joint else "base"] for joint in joints}
    for number, shape in enumerate(shapes):
        urdf_geometry(nodes[shape.parentJoint][f"{number}_{shape.name}"], shape)
    data = model.createData()
    poses: dict[int, list[pin.SE3]] = {joint: [] for joint in joints}
    for sample in q:
        pin.forwardKinematics(model, data, sample)
        for joint in joints:
            poses[joint].append(arm.base * data.oMi[joint])
    for joint in joints:
        move(nodes[joint], animation, poses[joint])
    corners = [(poses[s.parentJoint][0], corner) for s in shapes for corner in _corners(s)]
    return np.array([pose * corner for pose, corner in corners]).reshape(-1, 3)


def _draw_body(
    node: Visualizer, animation: Animation, body: BodyVisual, channels: dict[str, Any]
) -> Array:
    """Draw the body; return the points (world) that the camera shall see."""
    _, geometry, _ = load_geometry(body.urdf, pin.GeometryType.VISUAL, body.package_dirs)
    shapes = list(geometry.geometryObjects)
    for number, shape in enumerate(shapes):
        urdf_geometry(node[f"{number}_{shape.name}"], shape)
    poses: list[Any] = [body.placement]
    if body.placement is None:
        rows = _channel(channels, "pose", f"body {body.name!r}")
        poses = [pin.XYZQUATToSE3(row) for row in rows]
        move(node, animation, poses)
    else:
        node.set_transform(body.placement.homogeneous)
    corners = [corner for shape in shapes for corner in _corners(shape)] or [np.zeros(3)]
    return np.array([pose * corner for pose in poses[:: max(len(poses) // 20, 1)]
                     for corner in corners])  # fmt: skip


def _draw_contact(
    node: Visualizer, animation: Animation, index: int, channels: dict[str, Any]
) -> None:
    colour = contact_colour(index)
    points, directions = (
        np.asarray(channels[key], dtype=float)[:, index]
        for key in ("contact_point", "contact_direction")
    )
    known = np.isfinite(points).all(axis=1) & (np.linalg.norm(directions, axis=1) > 0.5)
    closed = known & channels["closed"][:, index].astype(bool) if "closed" in channels else known
    poses = [
        along(p, d) if ok else pin.SE3.Identity()
        for p, d, ok in zip(points, directions, known, strict=True)
    ]
    move(node, animation, poses)
    line_of_force(node["line_of_force"], colour, LINE_OF_FORCE_LENGTH)
    track(node["line_of_force"], animation, "visible", "boolean", closed)
    for name, key, width, opacity in (
        ("force", "alpha_true", 0.006, 1.0),
        ("desired", "alpha_cmd", 0.011, 0.3),
    ):
        if key not in channels:
            continue
        alpha = np.asarray(channels[key], dtype=float)[:, index]
        arrow(node[name], colour, width, opacity)
        shaft, shaft_y, head = arrow_lengths(ARROW_METRES_PER_NEWTON * alpha)
        base = np.column_stack([np.zeros_like(shaft_y), shaft_y, np.zeros_like(shaft_y)])
        track(node[name]["shaft"], animation, "scale", "vector3", shaft)
        track(node[name]["shaft"], animation, "position", "vector3", base)
        track(node[name]["head"], animation, "scale", "vector3", head)
        shown = (closed if name == "force" else known) & (alpha > 1e-3)
        track(node[name], animation, "visible", "boolean", shown)


def _corners(shape: pin.GeometryObject) -> list[Array]:
    """Corners of the shape's bounding box, in its parent joint."""
    shape.geometry.computeLocalAABB()
    box = shape.geometry.aabb_local
    low, high = (np.array(end) for end in (box.min_, box.max_))
    return [shape.placement * np.where(pick, high, low) for pick in product((0, 1), repeat=3)]
