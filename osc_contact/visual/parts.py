"""What a scene is made of: parts that are drawn once and then only move, grow, appear, vanish.

A part says where its nodes are at one recorded tick. The same answer becomes key frames of a page
that plays by itself, and drawing commands of a live view.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

if TYPE_CHECKING:
    from meshcat import Visualizer
    from meshcat.animation import Animation

__all__ = ["Frame", "LegendEntry", "Part", "Sample", "State", "animate", "changes", "track"]

Sample = Mapping[str, Any]
"""The channels of a recording at one tick."""


class State(NamedTuple):
    """Where a node is in its parent: None leaves a thing as it was drawn.

    Attributes:
        pose: placement in the parent node.
        scale: along the node's own axes.
        visible: with everything below it.
    """

    pose: pin.SE3 | None = None
    scale: tuple[float, float, float] | None = None
    visible: bool | None = None


Frame = dict[str, State]
"""State of every moving node by its path below the scene's root; always the same nodes."""


class LegendEntry(NamedTuple):
    """A line of the page's legend.

    Attributes:
        colour: ``#RRGGBB``.
        text: what is meant.
        look: how the sample is drawn: solid, pale, thin, grey, turn or frame.
        paths: nodes that its check box shows and hides; none: no check box.
        shown: whether they are shown at first.
    """

    colour: str
    text: str
    look: str = "solid"
    paths: tuple[str, ...] = ()
    shown: bool = True


class Part(Protocol):
    """One part of a scene."""

    def draw(self, scene: Visualizer) -> None:
        """Make the nodes."""

    def states(self, sample: Sample) -> Frame:
        """Where they are at one tick."""

    def legend(self) -> Iterable[LegendEntry]:
        """What the legend says about them."""


def animate(scene: Visualizer, animation: Animation, frames: Sequence[Frame]) -> None:
    """Start at the first frame and animate through all of them; what never changes is set once.

    Args:
        scene: of the page.
        animation: that takes the key frames.
        frames: where everything is, one entry a frame.
    """
    for path, first in frames[0].items():
        node, states = scene[path], [frame[path] for frame in frames]
        if first.pose is not None:
            node.set_transform(first.pose.homogeneous)
            poses = np.array([pin.SE3ToXYZQUAT(state.pose) for state in states])
            track(node, animation, "position", "vector3", poses[:, :3])
            track(node, animation, "quaternion", "quaternion", poses[:, 3:])
        if first.scale is not None:
            node.set_property("scale", list(first.scale))
            track(node, animation, "scale", "vector3", np.array([s.scale for s in states]))
        if first.visible is not None:
            node.set_property("visible", bool(first.visible))
            track(node, animation, "visible", "boolean", np.array([s.visible for s in states]))


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

    changed = values[1:] != values[:-1]
    same = ~changed.any(axis=tuple(range(1, values.ndim)))
    if same.all():
        return
    inner = np.zeros(len(values), dtype=bool)
    inner[1:-1] = same[:-1] & same[1:]
    frames = np.flatnonzero(~inner)
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
        if state.pose is not None or state.scale is not None:
            matrix = _matrix(state)
            if path not in before or not np.array_equal(matrix, _matrix(old)):
                scene[path].set_transform(matrix)
        if state.visible is not None and state.visible != old.visible:
            scene[path].set_property("visible", bool(state.visible))


def _matrix(state: State) -> NDArray[np.float64]:
    matrix: NDArray[np.float64] = np.eye(4) if state.pose is None else state.pose.homogeneous
    if state.scale is not None:
        matrix = matrix * np.array([*state.scale, 1.0])
    return matrix
