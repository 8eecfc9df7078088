"""What a scene shows, and its arms, held object and faces, drawn from their URDFs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from osc_contact.errors import InvalidInputError
from osc_contact.robots import is_mjcf, load_geometry
from osc_contact.robots.pictures import mjcf_geometry, read_picture
from osc_contact.visual.parts import Frame, LegendEntry, Sample, State
from osc_contact.visual.primitives import urdf_geometry

if TYPE_CHECKING:
    from meshcat import Visualizer

__all__ = ["MovingArm", "ArmVisual", "MovingBody", "BodyVisual", "Content"]

Array = NDArray[np.float64]


class ArmVisual(NamedTuple):
    """An arm to draw: its URDF, MJCF or picture (`robots.pictures`), where its base stands (X_WB),
    where its joints are in q.

    Joints that q does not have are in `locked`, with their positions (m, rad). Of an MJCF file the
    tree is drawn that `tip` belongs to.
    """

    name: str
    urdf: str | Path | Mapping[str, Any]
    package_dirs: Sequence[str | Path]
    base: pin.SE3
    q_slice: slice
    locked: Mapping[str, float] = {}
    tip: str | None = None


class BodyVisual(NamedTuple):
    """A body to draw: fixed at the placement (X_WB), or moving with the object when None.

    A body that is the face of contact number `face` moves by the channel ``face_pose`` (pose of
    its URDF's frame in the world) if the recording has one, and stays at the placement otherwise.
    """

    name: str
    urdf: str | Path
    package_dirs: Sequence[str | Path]
    placement: pin.SE3 | None
    face: int | None = None


@dataclass(frozen=True)
class Content:
    """What a scene shows.

    Attributes:
        title: heading.
        arms: moved by the channel ``q``.
        bodies: faces, and the object, moved by ``pose``.
        contacts: names of the contacts.
        columns: which contact each column of N belongs to; empty: one column per contact.
        frame_words: what the legend says about the best single frame.
    """

    title: str
    arms: Sequence[ArmVisual]
    bodies: Sequence[BodyVisual]
    contacts: Sequence[str] = ()
    columns: Sequence[int] = ()
    frame_words: str = "best single frame (Raibert–Craig)"


def _shapes(arm: ArmVisual) -> tuple[pin.Model, pin.GeometryModel]:
    """Kinematics and shapes of an arm's file."""
    if isinstance(arm.urdf, Mapping):
        return read_picture(arm.urdf)
    if is_mjcf(arm.urdf):
        return mjcf_geometry(arm.urdf, arm.tip)
    kind = pin.GeometryType.VISUAL
    model, geometry, _ = load_geometry(arm.urdf, kind, arm.package_dirs)
    return model, geometry


class MovingArm:
    """An arm that moves by its joint positions."""

    def __init__(self, arm: ArmVisual) -> None:
        self.arm = arm
        self.model, geometry = _shapes(arm)
        self.data = self.model.createData()
        self.shapes = list(geometry.geometryObjects)
        names = list(self.model.names)[1:]
        self.q = np.array([arm.locked.get(name, 0.0) for name in names])
        self.moving = [j for j, name in enumerate(names) if name not in arm.locked]
        joints = sorted({shape.parentJoint for shape in self.shapes})
        self.paths = {
            joint: f"arms/{arm.name}/{self.model.names[joint] if joint else 'base'}"
            for joint in joints
        }

    def draw(self, scene: Visualizer) -> None:
        """Make the nodes."""
        for number, shape in enumerate(self.shapes):
            node = scene[self.paths[shape.parentJoint]]
            urdf_geometry(node[f"{number}_{shape.name}"], shape)

    def states(self, sample: Sample) -> Frame:
        """Placement of every moving link; where q is not known (NaN) it stays as it was.

        Raises:
            InvalidInputError: q is not recorded, or its slice does not fit the URDF.
        """
        q = _channel(sample, "q", f"arm {self.arm.name!r}")[self.arm.q_slice]
        if self.model.nq != self.model.nv or q.shape != (len(self.moving),):
            raise InvalidInputError(
                f"arm {self.arm.name!r}: {self.arm.q_slice} takes {q.size} numbers of q, "
                f"but its model has nq = {self.model.nq}, {len(self.arm.locked)} locked"
            )
        if np.isfinite(q).all():
            self.q[self.moving] = q
        pin.forwardKinematics(self.model, self.data, self.q)
        return {
            path: State(self.arm.base * self.data.oMi[joint]) for joint, path in self.paths.items()
        }

    def legend(self) -> Iterable[LegendEntry]:
        """Nothing: arms explain themselves."""
        return ()

    def corners(self, sample: Sample) -> Array:
        """(k, 3) corners of the bounding boxes, or points of meshes, at one tick, and the base."""
        states = self.states(sample)
        points: list[Any] = [self.arm.base.translation]
        for shape in self.shapes:
            pose: Any = states[self.paths[shape.parentJoint]].pose
            points += [pose * corner for corner in _corners(shape)]
        return np.array(points)


class MovingBody:
    """The held object, or a face at rest or in motion."""

    def __init__(self, body: BodyVisual) -> None:
        self.body = body
        _, geometry, _ = load_geometry(body.urdf, pin.GeometryType.VISUAL, body.package_dirs)
        self.shapes = list(geometry.geometryObjects)
        self.path = f"bodies/{body.name}"
        self.last = pin.SE3.Identity() if body.placement is None else body.placement

    def draw(self, scene: Visualizer) -> None:
        """Make the nodes."""
        for number, shape in enumerate(self.shapes):
            urdf_geometry(scene[self.path][f"{number}_{shape.name}"], shape)
        if self.body.placement is not None:
            scene[self.path].set_transform(self.body.placement.homogeneous)

    def states(self, sample: Sample) -> Frame:
        """Its placement, if it moves."""
        placement = self._placement(sample)
        return {} if placement is self.body.placement else {self.path: State(placement)}

    def legend(self) -> Iterable[LegendEntry]:
        """Nothing: bodies explain themselves."""
        return ()

    def corners(self, sample: Sample) -> Array:
        """(k, 3) corners of the bounding boxes at one tick."""
        pose = self._placement(sample)
        corners = [corner for shape in self.shapes for corner in _corners(shape)] or [np.zeros(3)]
        return np.array([pose * corner for corner in corners])

    def _placement(self, sample: Sample) -> pin.SE3:
        if self.body.face is not None and "face_pose" in sample:
            pose = np.asarray(sample["face_pose"], dtype=float)[self.body.face]
        elif self.body.placement is None:
            pose = _channel(sample, "pose", f"body {self.body.name!r}")
        else:
            return self.body.placement
        if np.isfinite(pose).all():  # else it is not known, and stays where it was
            self.last = pin.XYZQUATToSE3(pose)
        return self.last


def _channel(sample: Sample, key: str, needed_by: str) -> Array:
    if key not in sample:
        raise InvalidInputError(f"{needed_by} moves with the channel {key!r}: it is not recorded")
    return np.asarray(sample[key], dtype=float)


def _corners(shape: Any) -> list[Array]:
    """Corners of the shape's bounding box, or points of its mesh, in its parent joint."""
    import coal

    if isinstance(shape.geometry, coal.BVHModelBase):
        vertices = np.asarray(shape.geometry.vertices(), dtype=float).reshape(-1, 3)
        return [shape.placement * vertex for vertex in vertices[:: len(vertices) // 50 + 1]]
    shape.geometry.computeLocalAABB()
    box = shape.geometry.aabb_local
    low, high = (np.array(end) for end in (box.min_, box.max_))
    return [shape.placement * np.where(pick, high, low) for pick in product((0, 1), repeat=3)]
