"""Everything a run leaves behind: metrics.json, the recording, figures and the scene."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from osc_contact.errors import InvalidInputError
from osc_contact.files import whole_file
from osc_contact.recorder import Recording
from osc_contact.recorder.judged import SETTLE_S, judged_ticks
from osc_contact.runs.metrics import metrics
from osc_contact.runs.rig import build_rig
from osc_contact.runs.viewing import DRAWN, write_scene_of
from osc_contact.scenarios.schema import Scenario

__all__ = ["require_judgeable", "write_json", "write_report"]


def require_judgeable(scenario: Scenario) -> None:
    """Refuse, before it runs, a run that would end before it can be judged.

    Raises:
        InvalidInputError: with the time from which runs are judged.
    """
    if scenario.duration <= SETTLE_S:
        raise InvalidInputError(
            f"duration {scenario.duration:g} s: a run is judged from t = {SETTLE_S:g} s on; "
            "run it longer"
        )


def write_report(recording: Recording, scenario: Scenario, folder: Path) -> dict[str, Any]:
    """Write metrics.json, recording.npz, the figures and scene.html; returns the metrics.

    Args:
        recording: of the run. scenario: that was run. folder: for the files.
    """
    from osc_contact.visual import plots

    folder.mkdir(parents=True, exist_ok=True)
    recording.save(folder / "recording.npz")
    verdict = metrics(recording)
    write_json(verdict, folder / "metrics.json")
    recording = recording.thinned(DRAWN)
    forces, whole = judged_ticks(recording)
    if recording.meta["contact_names"]:
        plots.save(plots.contact_forces(recording, forces), folder / "contact_forces")
    plots.save(plots.power(recording, whole), folder / "power")
    plots.save(plots.tracking(recording, SETTLE_S), folder / "tracking")
    plots.save(plots.torques(recording), folder / "torques")
    write_scene_of(recording, build_rig(scenario), folder / "scene.html")
    return verdict


def write_json(data: Any, path: Path) -> None:
    """Write JSON, a file that appears complete or not at all."""
    with whole_file(path) as unfinished:
        unfinished.write_text(json.dumps(data, indent=2) + "\n", encoding="utf-8")
