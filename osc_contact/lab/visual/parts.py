"""Parts of a scene, which are drawn once and then change only pose, scale and visibility.

A part computes the states of its nodes at recorded ticks, which become key frames of a page, or
drawing commands of a live view. Arms, the held object and faces are drawn from URDFs; marks of
contacts are in `lab.visual.marks`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from osc_contact.errors import InvalidInputError
from osc_contact.lab.visual.key_frames import Animation
from osc_contact.lab.visual.shapes import urdf_geometry
from osc_contact.robots import is_mjcf, load_geometry
from osc_contact.robots.model import joint_names
from osc_contact.robots.pictures import mjcf_geometry, read_picture
from osc_contact.spatial import Array

if TYPE_CHECKING:
    from meshcat import Visualizer


Samples = Mapping[str, Any]
"""The channels of a recording at F ticks, (F, …) each; for marks at contacts also `normals`."""


class States(NamedTuple):
    """States of a node in its parent at F ticks.

    None leaves a property at the value with which it was drawn.

    Attributes:
        poses: (F, 7) in the parent node, x y z (m) and quaternion x y z w.
        scale: (F, 3) along the node's own axes.
        visible: (F,) with everything below it.
    """

    poses: Array | None = None
    scale: Array | None = None
    visible: NDArray[np.bool_] | None = None

    def matrix(self, tick: int = 0) -> Array | None:
        """Matrix (4, 4) that scales, then places the node; None without pose and scale.

        Args:
            tick: index of the tick.
        """
        if self.poses is None and self.scale is None:
            return None
        matrix: Array = np.eye(4)
        if self.poses is not None:
            matrix = pin.XYZQUATToSE3(self.poses[tick]).homogeneous
        if self.scale is not None:
            matrix = matrix * [*self.scale[tick], 1.0]
        return matrix


Frames = dict[str, States]
"""States of every moving node by its path below the scene's root; always the same nodes."""


def held(is_known: NDArray[np.bool_], values: Array, before: Array) -> Array:
    """Hold values until a new one is known: the newest values (F, n) at each of F ticks.

    Args:
        is_known: (F,) flags of the k ticks with a new value.
        values: (k, n) new values in their order.
        before: (n,) value before the first new one.
    """
    return np.vstack([before, values])[np.cumsum(is_known)]


class LegendEntry(NamedTuple):
    """A line of the page's legend.

    Attributes:
        colour: ``#RRGGBB``.
        text: text of the line.
        look: style of the sample: solid, pale, thin, grey or turn.
        paths: nodes that its check box shows and hides; empty: no check box.
    """

    colour: str
    text: str
    look: str = "solid"
    paths: tuple[str, ...] = ()


class Part(Protocol):
    """Part of a scene."""

    def draw(self, scene: Visualizer) -> None:
        """Make the nodes of the part."""

    def states(self, samples: Samples) -> Frames:
        """States of the nodes at F ticks."""


# --- From states to pages -----------------------------------------------------------------------


def animate(scene: Visualizer, animation: Animation, frames: Frames) -> None:
    """Set all nodes to their states in the first frame, and append key frames of their properties.

    Poses, scales and visibility of a node are animated if its states have them.

    Args:
        scene: root of the scene.
        animation: animation to which the key frames are appended.
        frames: states of all moving nodes.
    """
    for path, states in frames.items():
        node = scene[path]
        place = node.path.lower()
        if states.poses is not None:
            node.set_transform(pin.XYZQUATToSE3(states.poses[0]).homogeneous)
            animation.track(place, "position", "vector3", states.poses[:, :3])
            animation.track(place, "quaternion", "quaternion", states.poses[:, 3:])
        if states.scale is not None:
            node.set_property("scale", states.scale[0].tolist())
            animation.track(place, "scale", "vector3", states.scale)
        if states.visible is not None:
            node.set_property("visible", bool(states.visible[0]))
            animation.track(place, "visible", "boolean", states.visible)


def changes(scene: Visualizer, before: Frames, after: Frames) -> None:
    """Send the new matrix or visibility of each node whose state changed between two ticks.

    Args:
        scene: root of the scene.
        before: states at the earlier tick; if empty, all nodes are sent.
        after: states of the same nodes at a later tick.
    """
    for path, states in after.items():
        states_before = before.get(path, States())
        matrix = states.matrix()
        matrix_before = states_before.matrix()
        if matrix is not None and (
            matrix_before is None or not np.array_equal(matrix, matrix_before)
        ):
            scene[path].set_transform(matrix)
        visible_before = states_before.visible
        if states.visible is not None and (
            visible_before is None or states.visible != visible_before
        ):
            scene[path].set_property("visible", bool(states.visible[0]))


# --- Arms, object and faces ---------------------------------------------------------------------


class Visual(NamedTuple):
    """Arm or body to be drawn.

    Attributes:
        name: name of its nodes.
        urdf, package_dirs: URDF, MJCF or picture (`robots.pictures`) and the folders of its meshes.
        base: pose of its base (X_WB); None: it moves with the object.
        q_slice: positions of its joints in q.
        locked: positions (m, rad) of joints that are not in q.
        tip: body of an MJCF file whose kinematic tree is drawn.
        face: index of the contact of which it is the face; it moves by the channel ``face_pose``
            (pose of its URDF's frame in the world) if the recording has one, and otherwise remains
            at its base.
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
    """Content of a scene.

    Attributes:
        title: heading of the page.
        arms: arms, which the channel ``q`` moves.
        bodies: faces, and the object (base None), which the channel ``pose`` moves.
        contacts: names of the contacts.
        columns: index of the contact of each column of N; empty: one column per contact.
        joints: number of joints in q.
    """

    title: str
    arms: Sequence[Visual]
    bodies: Sequence[Visual] = ()
    contacts: Sequence[str] = ()
    columns: Sequence[int] = ()
    joints: int = 0


class Moving(Part):
    """Arm that moves by its joint positions, held object, or face at rest or in motion.

    Each joint with shapes has a node.
    """

    def __init__(self, visual: Visual, folder: str) -> None:
        """Load the shapes of a robot, object or body.

        Args:
            visual: its file, base pose, joints and locked joints.
            folder: path of its nodes in the scene.
        """
        self.what = visual
        self.model, geometry = _shapes(visual)
        self.data = self.model.createData()
        names = joint_names(self.model)
        nodes = [f"{folder}/{visual.name}/{name}" for name in ("base", *names)]
        self.shapes = list(geometry.geometryObjects)
        self.paths = {shape.parentJoint: nodes[shape.parentJoint] for shape in self.shapes}
        self.base = pin.SE3ToXYZQUAT(visual.base or pin.SE3.Identity())
        self.q = np.array([visual.locked.get(name, 0.0) for name in names])
        self.moving = [j for j, name in enumerate(names) if name not in visual.locked]

    def draw(self, scene: Visualizer) -> None:
        """Make the nodes."""
        for number, shape in enumerate(self.shapes):
            node = scene[self.paths[shape.parentJoint]]
            urdf_geometry(node[f"{number}_{shape.name}"], shape)

    def states(self, samples: Samples) -> Frames:
        """Poses of all moving nodes; where q or pose is unknown (NaN) the last ones are repeated.

        Args:
            samples: channels of the ticks to be drawn.

        Raises:
            InvalidInputError: a channel is not recorded, or the slice of q does not fit the URDF.
        """
        poses: dict[int, list[Array]] = {joint: [] for joint in self.paths}
        for placed in self._placements(samples):
            for joint, joint_poses in poses.items():
                joint_poses.append(pin.SE3ToXYZQUAT(placed[joint]))
        return {path: States(np.array(poses[joint])) for joint, path in self.paths.items()}

    def corners(self, samples: Samples) -> Array:
        """Origins, and corners of bounding boxes or points of meshes, (k, 3) in the world (m).

        Args:
            samples: recorded channels; the points of all their ticks are returned.
        """
        corners = [(shape.parentJoint, _corners(shape)) for shape in self.shapes]
        points = []
        for placed in self._placements(samples):
            points.append(placed[0].translation[None])
            for joint, joint_corners in corners:
                points.append(joint_corners @ placed[joint].rotation.T + placed[joint].translation)
        return np.vstack(points)

    def _placements(self, samples: Samples) -> Iterator[dict[int, pin.SE3]]:
        """Compute the poses in the world of the base and of all joints with shapes, tick by tick.

        Args:
            samples: recorded channels at F ticks.

        Yields:
            Poses of one tick by the index of the joint; 0 is the base.
        """
        ticks = len(next(iter(samples.values())))
        joints = {0, *self.paths}
        for q, base in zip(
            self._positions(samples, ticks), self._bases(samples, ticks), strict=True
        ):
            pin.forwardKinematics(self.model, self.data, q)
            X = pin.XYZQUATToSE3(base)
            yield {joint: X * self.data.oMi[joint] for joint in joints}

    def _positions(self, samples: Samples, ticks: int) -> Array:
        """Joint positions (F, nq) at F ticks; unknown ones (NaN) are replaced by the last known.

        Args:
            samples: recorded channels.
            ticks: number F of their ticks.
        """
        visual = self.what
        q = self._channel(samples, "q")[:, visual.q_slice] if self.moving else np.zeros((ticks, 0))
        if q.shape[1] != len(self.moving):
            raise InvalidInputError(
                f"{visual.name!r}: {visual.q_slice} takes {q.shape[1]} numbers of q, "
                f"but its model has nq = {self.model.nq}, {len(visual.locked)} locked"
            )
        is_known = np.asarray(np.isfinite(q).all(axis=1))
        positions = np.tile(self.q, (ticks, 1))
        positions[:, self.moving] = held(is_known, q[is_known], self.q[self.moving])
        self.q = positions[-1]
        return positions

    def _bases(self, samples: Samples, ticks: int) -> Array:
        """Poses (F, 7) of the base at F ticks; unknown ones (NaN) are replaced by the last known.

        Args:
            samples: recorded channels.
            ticks: number F of their ticks.
        """
        poses = np.full((ticks, 7), np.nan)
        if self.what.face is not None and "face_pose" in samples:
            poses = samples["face_pose"][:, self.what.face]
        elif self.what.base is None:
            poses = self._channel(samples, "pose")
        is_known = np.asarray(np.isfinite(poses).all(axis=1))
        bases = held(is_known, poses[is_known], self.base)
        self.base = bases[-1]
        return bases

    def _channel(self, samples: Samples, key: str) -> Array:
        """Channel at F ticks, by its name.

        Raises:
            InvalidInputError: the channel was not recorded.
        """
        if key not in samples:
            raise InvalidInputError(
                f"{self.what.name!r} moves with the channel {key!r}: it is not recorded"
            )
        return samples[key]


def _shapes(visual: Visual) -> tuple[pin.Model, pin.GeometryModel]:
    """Kinematics and shapes of an arm or body, from its URDF, MJCF or picture.

    Args:
        visual: shapes of a body.
    """
    if isinstance(visual.urdf, Mapping):
        return read_picture(visual.urdf)
    if is_mjcf(visual.urdf):
        return mjcf_geometry(visual.urdf, visual.tip)
    return load_geometry(visual.urdf, pin.GeometryType.VISUAL, visual.package_dirs)[:2]


def _corners(shape: Any) -> Array:
    """Corners of a shape's bounding box, or some points of its mesh, in its parent joint's frame.

    Args:
        shape: geometry of Pinocchio with its placement.

    Returns:
        (k, 3) points (m).
    """
    import coal

    if isinstance(shape.geometry, coal.BVHModelBase):
        vertices = np.asarray(shape.geometry.vertices(), dtype=float).reshape(-1, 3)
        points = vertices[:: len(vertices) // 50 + 1]
    else:
        shape.geometry.computeLocalAABB()
        box = shape.geometry.aabb_local
        points = np.array(
            [np.where(pick, box.max_, box.min_) for pick in product((0, 1), repeat=3)]
        )
    return points @ shape.placement.rotation.T + shape.placement.translation
