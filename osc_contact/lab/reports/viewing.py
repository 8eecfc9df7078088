"""Scenes of scenarios and recordings: live views, replays, still and moving pictures."""

import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from time import monotonic, sleep
from typing import Any

import numpy as np
import pinocchio as pin

from osc_contact import robots
from osc_contact.contacts.feet import force_owners
from osc_contact.errors import InvalidInputError, RecordingError
from osc_contact.files import StrPath
from osc_contact.lab.plants.own_mujoco import MujocoRobot
from osc_contact.lab.rig.rig import Rig, build_rig
from osc_contact.lab.runs.recovery import scenario_of
from osc_contact.lab.scenarios.schema import Scenario
from osc_contact.lab.tasks.packaged import task_content
from osc_contact.lab.visual.browser import write_png
from osc_contact.lab.visual.live import CHANNELS, Viewer
from osc_contact.lab.visual.parts import Content, Visual
from osc_contact.lab.visual.run_figures import DRAWN
from osc_contact.lab.visual.scene import Scene, write_scene
from osc_contact.recorder import Recording

_LARGEST_PLAUSIBLE = 1e9  #: m, rad, N, W, largest plausible number in a recording


def content_of(what: Rig | MujocoRobot | Content) -> Content:
    """Content of pictures of a scenario's rig, or of a robot in a MuJoCo scene.

    Args:
        what: rig of a scenario, robot in a MuJoCo scene, or a content, which is returned.
    """
    if isinstance(what, Rig):
        return _content_of_rig(what)
    if isinstance(what, Content):
        return what
    pairs = what.contacts
    contacts = [pair.name for pair in pairs], force_owners(pairs).tolist()
    return _of_picture(what.picture(), what.chain.arms[0].name, contacts, what.chain.nq)


def content_of_recording(recording: Recording) -> Content:
    """Content of pictures of a recording that has a picture in its meta data.

    Args:
        recording: recording of a run without a scenario.

    Raises:
        RecordingError: the picture is damaged.
    """
    meta = recording.meta
    try:
        name = meta["arm_names"][0]
        joints = len(meta["joint_names"])
        contacts = meta["contact_names"], meta["columns"]
        content = _of_picture(meta["picture"], name, contacts, joints)
        Scene(content, {})  # raises an error if the picture is damaged
    except (KeyError, TypeError, IndexError, ValueError, InvalidInputError) as error:
        raise RecordingError(f"its picture cannot be drawn: {error}") from error
    return content


def _of_picture(
    picture: Any, name: str, contacts: tuple[Sequence[str], Sequence[int]], joints: int
) -> Content:
    """Content of a page with one robot that is drawn by its picture, without a scenario.

    Args:
        picture: shapes of the robot, see `robots.pictures`.
        name: name of the robot.
        contacts: names of the contacts, and index of the contact of each force.
        joints: number of joints.
    """
    arm = Visual(name, picture, (), pin.SE3.Identity(), slice(0, joints))
    return Content(name.replace("_", " "), [arm], [], *contacts, joints=joints)


def shown_of(recording: Recording, path: Path, folder: StrPath | None = None) -> Content:
    """Content of pictures of a recording, from its picture, its packaged task or its scenario.

    Args:
        recording: the recording.
        path: its file.
        folder: folder of the scenario's files, see `scenario_of`.

    Raises:
        RecordingError: the recording has neither a picture nor a scenario.
    """
    if "picture" in recording.meta:
        return content_of_recording(recording)
    if "packaged_task" in recording.meta:
        return task_content(recording)
    return content_of(build_rig(scenario_of(recording.meta, path, folder)))


def write_scene_of(
    recording: Recording, rig: Rig | Content, path: Path, still: float | None = None
) -> Path:
    """Write the moving scene of a run as one HTML file that works without a server.

    Args:
        recording: recording of a run of this rig.
        rig: the rig, or the content of its scene.
        path: file of the page.
        still: time (s) at which the page opens as a still picture; None: the page plays.
    """
    return write_scene(recording.thinned(DRAWN), content_of(rig), path, still=still)


def require_drawable(recording: Recording, content: Content, source: str) -> None:
    """Refuse a recording that does not fit the content of its scene; channels may be missing.

    Args:
        recording: recording read from a file.
        content: content of the scene.
        source: name of the file.

    Raises:
        RecordingError: other contacts, channels of other shapes, times that do not increase, or
            numbers too large to be drawn. NaN is permitted for values of held ticks.
    """
    # the recording must be of the same contacts and forces
    names = list(content.contacts)
    owners = list(content.columns)
    for key, of_rig in (("contact_names", names), ("columns", owners)):
        if recording.meta.get(key, of_rig) != of_rig:
            raise RecordingError(
                f"{source}: its {key} are {recording.meta[key]!r}; runs of {content.title} "
                f"have {of_rig!r}"
            )
    # shapes and sizes of the channels; at most DRAWN ticks are looked at
    sizes = {"joints": content.joints, "contacts": len(names), "forces": len(owners)}
    recording = recording.thinned(DRAWN)
    for name, sides in CHANNELS.items():
        shape = tuple(side if isinstance(side, int) else sizes[side] for side in sides)
        if name not in recording and name != "t":
            continue
        values = np.asarray(recording[name], dtype=float)
        if values.shape[1:] != shape:
            raise RecordingError(
                f"{source}: channel {name!r} has shape {values.shape[1:]} at a tick; runs of "
                f"{content.title} have {shape}"
            )
        if np.abs(values).max(initial=0.0, where=~np.isnan(values)) > _LARGEST_PLAUSIBLE:
            raise RecordingError(
                f"{source}: channel {name!r} holds numbers above {_LARGEST_PLAUSIBLE:g}"
            )
    # the slider of the page needs increasing times
    t = np.asarray(recording["t"], dtype=float)
    if not (np.isfinite(t).all() and (np.diff(t) > 0.0).all()):
        raise RecordingError(f"{source}: channel 't' does not grow from tick to tick")


def _content_of_rig(rig: Rig) -> Content:
    """Parts of the scene of a rig: arms, object, bodies of the environment.

    A `Visual` has a name, a URDF with the folders of its meshes, and its pose in the world (None:
    that of the channel `pose`). An arm also has its part of the joint positions q, the positions of
    locked joints and its tip; a body has the index of a contact, whose channel `face_pose` moves
    it.

    Args:
        rig: rig of a scenario.
    """
    scenario = rig.scenario
    source = scenario.folder
    arms = [
        Visual(
            arm.name, *robots.resolve_urdf(spec.urdf, source), arm.base, part, arm.locked, arm.tip
        )
        for spec, arm, part in zip(scenario.arms, rig.chain.arms, rig.chain.slices, strict=True)
    ]
    bodies = [Visual("object", *robots.resolve_urdf(scenario.object.urdf, source), None)]
    for body in rig.bodies:
        bodies.append(Visual(body.name, *body.urdf, body.placement, face=body.contacts[0]))
    return Content(
        scenario.name.replace("_", " "),
        arms,
        bodies,
        tuple(pair.name for pair in rig.pairs),
        tuple(rig.owners.tolist()),
        rig.chain.nq,
    )


def open_viewer(what: str | Path | Scenario | MujocoRobot | Content, rate: float = 30.0) -> Viewer:
    """Open a live view of runs, for ``run(scenario, viewer=...)`` or ``run_loop(...)``.

    Args:
        what: a scenario, its name or path as for `load_scenario`, or a robot in a MuJoCo scene.
        rate: largest number of pictures per second, 1 … 60.

    Returns:
        The viewer; its `url` opens in a browser on this machine, `close` ends it.

    Raises:
        ViewerError: the page's server does not start.
    """
    content = content_of(build_rig(what) if isinstance(what, str | Path | Scenario) else what)
    return Viewer(content, rate)


class RealTime:
    """Viewer that slows a run or a replay down to real time."""

    def __init__(self, viewer: Viewer) -> None:
        """Set the viewer; real time begins with the first tick."""
        self.viewer = viewer
        self.begin: float | None = None

    def show(self, tick: Mapping[str, Any]) -> None:
        """Show a tick, then wait until its time."""
        self.viewer.show(tick)
        t = float(tick["t"])
        if self.begin is None:
            self.begin = monotonic() - t
        sleep(max(0.0, self.begin + t - monotonic()))


def replay(recording: Recording, viewer: Viewer) -> None:
    """Show a recording in real time, until its end or an error of the viewer."""
    clock = RealTime(viewer)
    for tick in range(len(recording)):
        if viewer.error is not None:
            return
        clock.show(recording.at(tick))


def wait_for(condition: Callable[[], bool], seconds: float) -> bool:
    """Wait until a condition is true, which is evaluated ten times per second.

    Args:
        condition: function without arguments.
        seconds: longest time to wait (s).

    Returns:
        False if the condition was not true in this time.
    """
    end = monotonic() + seconds
    while not condition():
        if monotonic() >= end:
            return False
        sleep(0.1)
    return True


def picture(recording: Recording, rig: Rig | Content, path: Path, time: float | None) -> Path:
    """Write a PNG of a recording's scene at one time.

    Args:
        recording: the recording.
        rig: its rig, or the content of the scene.
        path: file of the PNG.
        time: time in the recording (s); None: its middle.

    Raises:
        ViewerError: there is no browser to render it.
        InvalidInputError: the time is not in the recording.
    """
    t = recording["t"]
    moment = 0.5 * float(t[0] + t[-1]) if time is None else time
    if not t[0] <= moment <= t[-1] + 1e-3:
        raise InvalidInputError(
            f"time {moment:g} s is not in the recording, which spans {t[0]:g} to {t[-1]:g} s"
        )
    with _temporary_page(recording, rig) as page:
        return write_png(page, path, moment)


def moving_picture(
    recording: Recording, rig: Rig | Content, path: Path, write: Callable[..., Path]
) -> Path:
    """Write the scene of a whole recording as a moving picture.

    Args:
        recording: the recording.
        rig: its rig, or the content of the scene.
        path: file of the picture.
        write: `write_gif` or `write_mp4`.

    Raises:
        ViewerError: there is no browser to render it.
    """
    t = recording["t"]
    with _temporary_page(recording, rig) as page:
        return write(page, path, float(t[0]), float(t[-1]))


@contextmanager
def _temporary_page(recording: Recording, rig: Rig | Content) -> Iterator[Path]:
    """Context with the scene of a recording as a page in a temporary folder.

    Args:
        recording: recording to show.
        rig: rig or content of the page.

    Yields:
        Path of the page, which is deleted at the end of the context.
    """
    with tempfile.TemporaryDirectory(prefix="osc_contact_") as folder:
        yield write_scene_of(recording, rig, Path(folder) / "scene.html")
