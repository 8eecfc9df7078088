"""Watching: a recording played in real time, a run slowed down to it, a picture of one moment."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from time import monotonic, sleep
from typing import Any

from osc_contact.errors import InvalidInputError
from osc_contact.recorder import Recording
from osc_contact.runs.rig import Rig
from osc_contact.runs.viewing import Shown, write_scene_of
from osc_contact.visual.browser import find_browser, write_gif, write_png
from osc_contact.visual.live import Viewer

__all__ = ["RealTime", "moving_picture", "picture", "replay", "wait_for"]


class RealTime:
    """A viewer for watching: passes ticks on, and holds up whatever runs faster than real time."""

    def __init__(self, viewer: Viewer) -> None:
        self.viewer = viewer
        self.begin: float | None = None

    def show(self, tick: Mapping[str, Any]) -> None:
        """Pass the tick on, then wait until its time has come."""
        self.viewer.show(tick)
        t = float(tick["t"])
        if self.begin is None:
            self.begin = monotonic() - t
        sleep(max(0.0, self.begin + t - monotonic()))


def replay(recording: Recording, viewer: Viewer) -> None:
    """Show a recording in real time, until its end or the viewer's."""
    pace = RealTime(viewer)
    for tick in range(len(recording)):
        if viewer.error is not None:
            return
        pace.show(recording.at(tick))


def wait_for(condition: Callable[[], bool], seconds: float) -> bool:
    """Look ten times per second whether the condition has come true; False after `seconds`."""
    end = monotonic() + seconds
    while not condition():
        if monotonic() >= end:
            return False
        sleep(0.1)
    return True


def picture(recording: Recording, rig: Rig | Shown, path: Path, time: float | None) -> Path:
    """A PNG of the recording's page at a time (s), default the middle.

    Args:
        recording: to draw. rig: it was made on. path: of the PNG. time: s.

    Raises:
        ViewerError: there is no browser to render it.
        InvalidInputError: the time is not in the recording.
    """
    find_browser()
    t = recording["t"]
    moment = 0.5 * float(t[0] + t[-1]) if time is None else time
    if not t[0] <= moment <= t[-1] + 1e-3:
        raise InvalidInputError(
            f"time {moment:g} s is not in the recording, which spans {t[0]:g} to {t[-1]:g} s"
        )
    with tempfile.TemporaryDirectory(prefix="osc_contact_") as folder:
        page = write_scene_of(recording, rig, Path(folder) / "scene.html")
        return write_png(page, path, moment)


def moving_picture(
    recording: Recording, rig: Rig | Shown, path: Path, write: Callable[..., Path] = write_gif
) -> Path:
    """The whole recording, moving.

    Args:
        recording: what is shown.
        rig: the parts of its scenario.
        path: to write.
        write: write_gif or write_mp4.

    Raises:
        ViewerError: there is no browser to render it.
    """
    find_browser()
    t = recording["t"]
    with tempfile.TemporaryDirectory(prefix="osc_contact_") as folder:
        page = write_scene_of(recording, rig, Path(folder) / "scene.html")
        return write(page, path, float(t[0]), float(t[-1]))
