"""What is left of a run that was killed, as a recording."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from osc_contact.errors import ModelError, RecordingError, ScenarioError
from osc_contact.recorder import Recording
from osc_contact.recorder.journal import Journal
from osc_contact.robots import resolve_urdf
from osc_contact.runs.contacts import environment_bodies
from osc_contact.runs.recorder import recording_of
from osc_contact.runs.rig import build_rig
from osc_contact.runs.viewing import Shown
from osc_contact.scenarios.schema import Scenario

__all__ = ["recover", "scenario_of"]


def recover(
    path: str | os.PathLike[str], folder: str | os.PathLike[str] | None = None
) -> Recording:
    """The recording of a journal that a run left: all its chunks but those that are damaged.

    `meta["missing"]` has a sentence for each missing part.

    Args:
        path: such as unfinished.mcap.
        folder: of your own scenario, see `scenario_of`.

    Raises:
        RecordingError: no such file, nothing in it, or not the journal of a scenario's run.
    """
    source = Path(path)
    journal = Journal(source)
    rig = build_rig(scenario_of(journal.about, source, folder))
    plant, controller = rig.plant(int(journal.about.get("seed", 0))), rig.controller()
    recording = recording_of(rig.subject(controller), plant.log(), journal, journal.about)
    ticks = round(rig.scenario.duration * rig.scenario.control.rate)
    missing = list(journal.missing)
    if len(recording) < ticks:
        missing.append(f"{len(recording)} of {ticks} ticks are here")
    recording.meta["missing"] = missing
    return recording


def shown_of(
    recording: Recording, path: Path, folder: str | os.PathLike[str] | None = None
) -> Shown:
    """What a recording is of: the picture that it carries, or its scenario.

    Args:
        recording, path: as read, and its file. folder: as of `scenario_of`.

    Raises:
        RecordingError: it holds neither, see `scenario_of`.
    """
    if "picture" in recording.meta:
        return Shown.of_recording(recording)
    return Shown.of(build_rig(scenario_of(recording.meta, path, folder)))


def scenario_of(
    meta: dict[str, Any], path: Path, folder: str | os.PathLike[str] | None = None
) -> Scenario:
    """The scenario that a recording was made of.

    A recording holds no folders (SECURITY.md): URDFs that its scenario gives by path are looked for
    in `folder`, then beside the recording, then in the working folder.

    Args:
        meta: of the recording. path: of its file. folder: in which the scenario's file stands.

    Raises:
        RecordingError: it does not hold a scenario that this version understands, or its URDFs are
            in none of these places.
    """
    try:
        scenario = Scenario.model_validate(meta.get("scenario"))
    except (ScenarioError, ValueError) as error:
        raise RecordingError(f"{path} does not say which scenario was run: {error}") from error
    given = [] if folder is None else [Path(folder).resolve()]
    places = list(dict.fromkeys([*given, path.resolve().parent, Path.cwd()]))
    missing = ModelError()
    for place in places:
        placed = scenario.with_source(place / str(meta.get("source")))
        try:
            _require_urdfs(placed, place)
        except ModelError as error:
            missing = error
        else:
            return placed
    raise RecordingError(
        f"{path} needs files of its scenario, which are not in {', '.join(map(str, places))}. Give "
        "the scenario's folder (--folder, or folder= in Python), or start there, or copy them "
        f"beside the recording. ({missing})"
    )


def _require_urdfs(scenario: Scenario, folder: Path) -> None:
    for urdf in (*(arm.urdf for arm in scenario.arms), scenario.object.urdf):
        resolve_urdf(urdf, folder)
    environment_bodies(scenario)
