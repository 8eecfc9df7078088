"""What a scene is made of: parts that are drawn once and then only move, grow, appear, vanish.

A part gives the states of its nodes at one recorded tick. The same states become key frames of a
page that plays by itself, and drawing commands of a live view. Arms, the held object and faces are
the parts drawn from URDFs; those that mark contacts are in `visual.marks`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from osc_contact.errors import InvalidInputError
from osc_contact.robots import is_mjcf, load_geometry
from osc_contact.robots.model import joint_names
from osc_contact.robots.pictures import mjcf_geometry, read_picture
from osc_contact.spatial import Array
from osc_contact.visual.shapes import urdf_geometry

if TYPE_CHECKING:
    from meshcat import Visualizer
    from meshcat.animation import Animation


Sample = Mapping[str, Any]
"""The channels of a recording at one tick; for marks at contacts also its `normals`."""


class State(NamedTuple):
    """State of a node in its parent: None leaves a property at what it was drawn with.

    Attributes:
        pose: placement in the parent node.
        scale: along the node's own axes.
        visible: with everything below it.
    """

    pose: pin.SE3 | None = None
    scale: tuple[float, float, float] | None = None
    visible: bool | None = None

    @property
    def matrix(self) -> Any:
        """(4, 4) scaled, then placed; None where neither is given."""
        if self.pose is None and self.scale is None:
            return None
        placed = np.eye(4) if self.pose is None else self.pose.homogeneous
        return placed * [*(self.scale or (1.0, 1.0, 1.0)), 1.0]


Frame = dict[str, State]
"""State of every moving node by its path below the scene's root; always the same nodes."""


class LegendEntry(NamedTuple):
    """A line of the page's legend.

    Attributes:
        colour: ``#RRGGBB``.
        text: what is meant.
        look: how the sample is drawn: solid, pale, thin, grey or turn.
        paths: nodes that its check box shows and hides; none: no check box.
    """

    colour: str
    text: str
    look: str = "solid"
    paths: tuple[str, ...] = ()


class Part(Protocol):
    """One part of a scene."""

    def draw(self, scene: Visualizer) -> None:
        """Make the nodes."""

    def states(self, sample: Sample) -> Frame:
        """States of the nodes at one tick."""


# --- From states to pages -----------------------------------------------------------------------


def animate(scene: Visualizer, animation: Animation, frames: Sequence[Frame]) -> None:
    """Start at the first frame and animate through all of them; what never changes is set once.

    Args:
        scene: of the page.
        animation: that takes the key frames.
        frames: where everything is, one entry a frame.
    """
    for path in frames[0]:
        node = scene[path]
        poses, scales, seen = zip(*(frame[path] for frame in frames), strict=True)
        if poses[0] is not None:
            node.set_transform(poses[0].homogeneous)
            numbers = np.array([pin.SE3ToXYZQUAT(pose) for pose in poses])
            track(node, animation, "position", "vector3", numbers[:, :3])
            track(node, animation, "quaternion", "quaternion", numbers[:, 3:])
        for name, kind, values in (("scale", "vector3", scales), ("visible", "boolean", seen)):
            if values[0] is not None:
                node.set_property(name, values[0])
                track(node, animation, name, kind, np.array(values))


def track(
    node: Visualizer, animation: Animation, name: str, kind: str, values: NDArray[Any]
) -> None:
    """Key frames of one property; keys inside a stretch of equal values are left out.

    The last frame always has its key: tracks of unequal length would drift apart when repeated.

    Args:
        node: that moves.
        animation: that takes the key frames.
        name: the property, such as `position`.
        kind: its type in three.js, such as `vector3`.
        values: (frames, …) one value a frame.
    """
    from meshcat.animation import AnimationClip, AnimationTrack

    changed = np.any(values[1:] != values[:-1], axis=tuple(range(1, values.ndim)))
    if not changed.any():
        return
    frames = np.flatnonzero(np.append(True, changed) | np.append(changed, True))
    clip = animation.clips.setdefault(node.path, AnimationClip(fps=animation.default_framerate))
    clip.tracks[name] = AnimationTrack(name, kind, frames.tolist(), values[frames].tolist())


def changes(scene: Visualizer, before: Frame, after: Frame) -> None:
    """Send what differs from the frame before (an empty one: everything).

    Args:
        scene: of the page.
        before, after: two frames of the same parts.
    """
    for path, state in after.items():
        old = before.get(path, State())
        matrix = state.matrix
        if matrix is not None and not np.array_equal(matrix, old.matrix):
            scene[path].set_transform(matrix)
        if state.visible is not None and state.visible != old.visible:
            scene[path].set_property("visible", state.visible)


# --- Arms, object and faces ---------------------------------------------------------------------


class Visual(NamedTuple):
    """An arm or a body to draw.

    Attributes:
        name: of its nodes.
        urdf, package_dirs: URDF, MJCF or picture (`robots.pictures`) and the folders of its meshes.
        base: where it stands (X_WB); None: it moves with the object.
        q_slice: where its joints are in q.
        locked: positions (m, rad) of joints that q does not have.
        tip: whose tree of an MJCF file is drawn.
        face: the contact that it is the face of; it moves by the channel ``face_pose`` (pose of its
            URDF's frame in the world) if the recording has one, and stays at the base otherwise.
    """

    name: str
    urdf: str | Path | Mapping[str, Any]
    package_dirs: Sequence[str | Path]
    base: pin.SE3 | None
    q_slice: slice = slice(0)
    locked: Mapping[str, float] = {}
    tip: str | None = None
    face: int | None = None


@dataclass(frozen=True)
class Content:
    """What a scene shows.

    Attributes:
        title: heading.
        arms: moved by the channel ``q``.
        bodies: faces, and the object (base None), moved by ``pose``.
        contacts: names of the contacts.
        columns: which contact each column of N belongs to; empty: one column per contact.
        joints: how many q has.
    """

    title: str
    arms: Sequence[Visual]
    bodies: Sequence[Visual] = ()
    contacts: Sequence[str] = ()
    columns: Sequence[int] = ()
    joints: int = 0


class Moving(Part):
    """An arm that moves by its joint positions; the held object; a face at rest or in motion.

    Args:
        what: to draw. folder: node above that of its name. Joints with shapes have a node each.
    """

    def __init__(self, what: Visual, folder: str) -> None:
        self.what = what
        self.model, geometry = _shapes(what)
        self.data = self.model.createData()
        names = joint_names(self.model)
        nodes = [f"{folder}/{what.name}/{name}" for name in ("base", *names)]
        self.shapes = list(geometry.geometryObjects)
        self.paths = {shape.parentJoint: nodes[shape.parentJoint] for shape in self.shapes}
        self.base = what.base or pin.SE3.Identity()
        self.q = np.array([what.locked.get(name, 0.0) for name in names])
        self.moving = [j for j, name in enumerate(names) if name not in what.locked]

    def draw(self, scene: Visualizer) -> None:
        """Make the nodes."""
        for number, shape in enumerate(self.shapes):
            node = scene[self.paths[shape.parentJoint]]
            urdf_geometry(node[f"{number}_{shape.name}"], shape)

    def states(self, sample: Sample) -> Frame:
        """Placement of every moving node; where q or pose is not known (NaN) it stays.

        Raises:
            InvalidInputError: a channel is not recorded, or the slice of q does not fit the URDF.
        """
        self._move(sample)
        oMi = self.data.oMi
        return {path: State(self.base * oMi[joint]) for joint, path in self.paths.items()}

    def _move(self, sample: Sample) -> None:
        """Take over base and joint positions of one tick."""
        what = self.what
        q = self._channel(sample, "q")[what.q_slice] if self.moving else np.zeros(0)
        if q.shape != (len(self.moving),):
            raise InvalidInputError(
                f"{what.name!r}: {what.q_slice} takes {q.size} numbers of q, "
                f"but its model has nq = {self.model.nq}, {len(what.locked)} locked"
            )
        if np.isfinite(q).all():
            self.q[self.moving] = q
        pose = np.full(7, np.nan)
        if what.face is not None and "face_pose" in sample:
            pose = sample["face_pose"][what.face]
        elif what.base is None:
            pose = self._channel(sample, "pose")
        if np.isfinite(pose).all():
            self.base = pin.XYZQUATToSE3(pose)
        pin.forwardKinematics(self.model, self.data, self.q)

    def _channel(self, sample: Sample, key: str) -> Array:
        if key not in sample:
            raise InvalidInputError(
                f"{self.what.name!r} moves with the channel {key!r}: it is not recorded"
            )
        return np.asarray(sample[key], dtype=float)

    def corners(self, sample: Sample) -> Array:
        """(k, 3) origin, corners of the bounding boxes, or points of meshes, at one tick."""
        self._move(sample)
        points = [
            self.base * self.data.oMi[shape.parentJoint] * corner
            for shape in self.shapes
            for corner in _corners(shape)
        ]
        return np.array([self.base.translation, *points])


def _shapes(what: Visual) -> tuple[pin.Model, pin.GeometryModel]:
    """Kinematics and shapes of a file."""
    if isinstance(what.urdf, Mapping):
        return read_picture(what.urdf)
    if is_mjcf(what.urdf):
        return mjcf_geometry(what.urdf, what.tip)
    return load_geometry(what.urdf, pin.GeometryType.VISUAL, what.package_dirs)[:2]


def _corners(shape: Any) -> list[Array]:
    """Corners of the shape's bounding box, or points of its mesh, in its parent joint."""
    import coal

    if isinstance(shape.geometry, coal.BVHModelBase):
        vertices = np.asarray(shape.geometry.vertices(), dtype=float).reshape(-1, 3)
        return [shape.placement * vertex for vertex in vertices[:: len(vertices) // 50 + 1]]
    shape.geometry.computeLocalAABB()
    box = shape.geometry.aabb_local
    return [
        shape.placement * np.where(pick, box.max_, box.min_) for pick in product((0, 1), repeat=3)
    ]
