"""The three-dimensional picture of a recording: what is in it, and the page that plays it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from osc_contact.errors import InvalidInputError
from osc_contact.recorder import Recording, column_names
from osc_contact.visual import contact_colour, curves
from osc_contact.visual.bodies import ArmVisual, BodyVisual, Content, MovingArm, MovingBody
from osc_contact.visual.contact_marks import ContactForce, toggles
from osc_contact.visual.page import EMPTY, CommandSink, write_page
from osc_contact.visual.parts import Frame, LegendEntry, Part, Sample, animate
from osc_contact.visual.stage import set_stage
from osc_contact.visual.subspaces import T_COLOUR, ConstraintFrame, FindFrame, TwistAxes
from osc_contact.visual.trails import Trails

if TYPE_CHECKING:
    from meshcat import Visualizer

__all__ = ["Scene", "write_scene"]

MOST_FRAMES = 360
"""Key frames of a page; a longer recording gets fewer per second, and motion in between."""
Array = NDArray[np.float64]


class Scene:
    """The parts of a picture: drawn once, then moved at each tick.

    Args:
        content: what to show.
        first: the channels at the first tick; what is missing there is not drawn.
        find: the best single frame for N, or None to leave it out.
    """

    def __init__(self, content: Content, first: Sample, find: FindFrame | None = None) -> None:
        self.content = content
        self.arms = [MovingArm(arm) for arm in content.arms]
        self.bodies = [MovingBody(body) for body in content.bodies]
        self.parts: list[Part] = [*self.arms, *self.bodies]
        self.forces: list[ContactForce] = []
        located = {"contact_point", "contact_direction", "pose"} <= first.keys()
        contacts = list(content.contacts) if located else []
        if contacts:
            owners = list(content.columns) or list(range(len(contacts)))
            for column, name in enumerate(column_names(contacts, owners)):
                self.forces.append(ContactForce(name, column, owners[column], owners, first))
            axes = TwistAxes(first, owners)
            self.parts += [*self.forces, axes]
            if find is not None:
                self.parts.append(ConstraintFrame(find, owners, content.frame_words))
        self.trails = Trails(contacts)
        self.panels = curves.layout(first, contacts, content.columns)

    def draw(self, scene: Visualizer) -> None:
        """Make all nodes."""
        for part in self.parts:
            part.draw(scene)

    def states(self, sample: Sample) -> Frame:
        """Where everything is at one tick."""
        return {path: state for part in self.parts for path, state in part.states(sample).items()}

    def look(self, scene: Visualizer, samples: Sequence[Sample]) -> list[dict[str, Any]]:
        """Floor, background, and cameras that see what the samples show (see `set_stage`)."""
        near = [body.corners(sample) for body in self.bodies for sample in samples]
        near += [force.ends(sample) for force in self.forces for sample in samples]
        points = [arm.corners(samples[0]) for arm in self.arms] + near
        bases = np.array([arm.base.translation for arm in self.content.arms]).reshape(-1, 3)
        pushes = samples[0].get("contact_direction")
        empty = np.zeros((0, 3))
        return set_stage(
            scene, np.vstack([empty, *points]), bases, pushes, np.vstack([empty, *near])
        )

    def config(self, **more: Any) -> dict[str, Any]:
        """What the page's scripts want to know: legend, labels and plots."""
        entries: list[LegendEntry] = [e for force in self.forces for e in force.legend()]
        entries += toggles(self.forces)
        entries += [e for part in self.parts[len(self.arms) :] for e in part.legend() if e.paths]
        entries += self.trails.legend()
        lines = [line for panel in self.panels for line in panel["lines"]]
        keys = [(line["key"], line["index"]) for line in lines]
        labels = [
            {
                "path": f"{force.path}/label",
                "text": force.name.replace("_", " "),
                "colour": contact_colour(force.contact),
                "line": _place_in(keys, ("alpha_true", force.column)),
                "unit": "N m" if force.couple else "N",
                "lost": f"{force.path}/lost",
            }
            for force in self.forces
        ]
        if self.forces:
            labels += [
                {"path": f"twists/{i}/label", "text": f"t{'₁₂₃₄₅₆'[i]}", "colour": T_COLOUR,
                 "line": None, "unit": "", "lost": None}
                for i in range(6)
            ]  # fmt: skip
        legend = [entry._asdict() for entry in entries]
        return EMPTY | {"legend": legend, "labels": labels, "panels": self.panels} | more


def write_scene(
    recording: Recording,
    arms: Sequence[ArmVisual],
    bodies: Sequence[BodyVisual],
    path: str | Path,
    fps: float = 30.0,
    find: FindFrame | None = None,
    frame_words: str = "best single frame",
    still: float | None = None,
) -> Path:
    """Write the recording as an HTML page that plays by itself, with a time slider and plots.

    Args:
        recording: needs ``t``; draws from ``q``, ``pose``, ``face_pose`` and the contact channels
            what is there.
        arms: the arms, moved by ``q``.
        bodies: faces and the object (placement None), moved by ``pose``.
        path: the page to write.
        fps: key frames per second, fewer if they would be more than 360.
        find: the best single frame for N; frame_words: what the legend says about it.
        still: s; the page opens standing still at that time instead of playing.

    Returns:
        The path written.

    Raises:
        InvalidInputError: no ticks, fps < 1, a channel that a body needs is missing, or an arm's
            slice of q does not fit its URDF.
    """
    t = np.asarray(recording.channels["t"], dtype=float)
    if t.size == 0 or fps < 1:
        raise InvalidInputError(f"{t.size} ticks at {fps} frames/s make no picture: both need >= 1")
    length = float(t[-1] - t[0])
    fps = min(float(fps), MOST_FRAMES / length) if length > 0.0 else float(fps)
    times = np.arange(int(np.floor(length * fps + 1e-9)) + 1) / fps
    ticks = np.minimum(np.searchsorted(t - t[0], times - 1e-9), t.size - 1)
    samples = [sample_at(recording.channels, int(tick)) for tick in ticks]
    content = Content(
        _title(recording), arms, bodies, tuple(recording.meta.get("contact_names", ())),
        tuple(recording.meta.get("columns", ())), frame_words,
    )  # fmt: skip
    picture = Scene(content, samples[0], find)
    frames = [picture.states(sample) for sample in samples]
    sink = CommandSink()
    scene = sink.visualizer()
    from meshcat.animation import Animation

    animation = Animation(default_framerate=fps)
    picture.draw(scene)
    for sample in samples:
        picture.trails.extend(sample)
    picture.trails.draw(scene)
    animate(scene, animation, frames)
    cameras = picture.look(scene, samples[:: max(len(samples) // 20, 1)])
    scene.set_animation(animation, play=True, repetitions=float("inf"))
    config = picture.config(
        curves=curves.thinned(picture.panels, recording.channels),
        begin=float(t[0]),
        length=float(times[-1]),
        still=still,
        cameras=cameras,
    )
    return write_page(sink, path, content.title, config)


def sample_at(channels: Mapping[str, Any], tick: int) -> dict[str, Any]:
    """The channels at one tick."""
    return {key: np.asarray(value)[tick] for key, value in channels.items()}


def _title(recording: Recording) -> str:
    scenario = recording.meta.get("scenario", {})
    title = scenario.get("name", "recording") if isinstance(scenario, dict) else "recording"
    return str(title).replace("_", " ")


def _place_in(keys: Sequence[tuple[str, int]], key: tuple[str, int]) -> int | None:
    return keys.index(key) if key in keys else None
