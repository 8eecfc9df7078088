"""What is left of a run that was killed, as a recording."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from osc_contact.errors import RecordingError, ScenarioError
from osc_contact.recorder import Recording
from osc_contact.recorder.journal import Journal
from osc_contact.runs.recorder import recording_of
from osc_contact.runs.rig import build_rig
from osc_contact.scenarios.schema import Scenario

__all__ = ["recover", "scenario_of"]


def recover(path: str | os.PathLike[str]) -> Recording:
    """The recording of a journal that a run left: all its chunks but those that are damaged.

    What is missing is told in `meta["missing"]`, sentences; there are none if nothing is.

    Args:
        path: such as unfinished.mcap. A scenario of your own and its URDFs are looked for where
            they were, beside the file.

    Raises:
        RecordingError: no such file, nothing in it, or not the journal of a scenario's run.
    """
    source = Path(path)
    journal = Journal(source)
    rig = build_rig(scenario_of(journal.about, source))
    plant, controller = rig.plant(int(journal.about.get("seed", 0))), rig.controller()
    recording = recording_of(rig.subject(controller), plant.log(1), journal, journal.about)
    ticks = round(rig.scenario.duration * rig.scenario.control.rate)
    missing = list(journal.missing)
    if len(recording) < ticks:
        missing.append(f"{len(recording)} of {ticks} ticks are here")
    recording.meta["missing"] = missing
    return recording


def scenario_of(meta: dict[str, Any], path: Path) -> Scenario:
    """The scenario that a recording was made of; its own URDFs are looked for beside the file.

    Args:
        meta: of the recording. path: of its file.

    Raises:
        RecordingError: it does not hold a scenario that this version understands.
    """
    try:
        scenario = Scenario.model_validate(meta["scenario"])
    except (KeyError, ScenarioError, ValueError) as error:
        raise RecordingError(f"{path} does not say which scenario was run: {error}") from error
    return scenario.with_source(path.resolve().parent / str(meta.get("source")))
