"""Recording from the journal of an unfinished run, and the scenario of a recording."""

from __future__ import annotations

from pathlib import Path

from osc_contact.contacts.feet import force_owners
from osc_contact.errors import ModelError, RecordingError, ScenarioError
from osc_contact.files import Json, StrPath
from osc_contact.lab.rig.contacts import (
    build_pairs,
    environment_bodies,
    placements_of,
    touched_bodies,
)
from osc_contact.lab.rig.rig import TRUTHS, build_rig, life_of
from osc_contact.lab.scenarios.schema import Scenario
from osc_contact.loop.channels import Subject, recording_of
from osc_contact.recorder import Recording
from osc_contact.recorder.journal import Journal
from osc_contact.robots import resolve_urdf


def recover(path: StrPath, folder: StrPath | None = None) -> Recording:
    """Make a recording from the journal of an unfinished run, without its damaged chunks.

    `meta["missing"]` has a sentence for each missing part. Contacts and object are made from the
    scenario; arms and a plant are made only for a plant that is registered without `truths`.

    Args:
        path: file of the journal, for example unfinished.mcap.
        folder: folder of a custom scenario, see `scenario_of`.

    Raises:
        RecordingError: there is no such file, it is empty, or it is not the journal of a scenario's
            run.
    """
    source = Path(path)
    journal = Journal(source)
    scenario = scenario_of(journal.about, source, folder)
    pairs = build_pairs(scenario)
    bodies = environment_bodies(scenario)
    subject = Subject(
        pairs=pairs,
        placements=placements_of(bodies, touched_bodies(bodies, len(pairs))),
        owners=force_owners(pairs),
        dt=1.0 / scenario.control.rate,
        arms=len(scenario.arms),
        phased=life_of(scenario) is not None,
    )
    # the true forces are computed from the plant's rows, by its registered reader or a new plant
    kind = scenario.plant.type
    if kind in TRUTHS:
        truths = TRUTHS[kind](scenario, pairs)
    else:
        truths = build_rig(scenario).plant(int(journal.about.get("seed", 0))).log()
    recording = recording_of(subject, truths, journal, journal.about)
    ticks = round(scenario.duration * scenario.control.rate)
    missing = list(journal.missing)
    if len(recording) < ticks:
        missing.append(f"{len(recording)} of {ticks} ticks are here")
    recording.meta["missing"] = missing
    return recording


def scenario_of(meta: Json, path: Path, folder: StrPath | None = None) -> Scenario:
    """Read the scenario of a recording, and find the folder of its files.

    A recording has no folders (SECURITY.md): URDFs that its scenario gives by path are searched for
    in `folder`, then in the folder of the recording, then in the working folder.

    Args:
        meta: meta data of the recording.
        path: file of the recording.
        folder: folder of the scenario's file; None: unknown.

    Raises:
        RecordingError: the recording has no scenario that this version understands, or its URDFs
            are in none of these folders.
    """
    try:
        scenario = Scenario.model_validate(meta.get("scenario"))
    except (ScenarioError, ValueError) as error:
        raise RecordingError(f"{path} does not hold the scenario that was run: {error}") from error
    folders = [path.resolve().parent, Path.cwd()]
    if folder is not None:
        folders.insert(0, Path(folder).resolve())
    folders = list(dict.fromkeys(folders))  # each once
    missing = ModelError()
    for candidate in folders:
        candidate_scenario = scenario.with_source(candidate / str(meta.get("source")))
        try:
            for urdf in (
                *(arm.urdf for arm in candidate_scenario.arms),
                candidate_scenario.object.urdf,
            ):
                resolve_urdf(urdf, candidate)
            environment_bodies(candidate_scenario)
        except ModelError as error:
            missing = error
        else:
            return candidate_scenario
    raise RecordingError(
        f"{path} needs files of its scenario, which are not in {', '.join(map(str, folders))}. "
        "Give the scenario's folder (--folder, or folder= in Python), or start there, or copy them "
        f"beside the recording. ({missing})"
    )
