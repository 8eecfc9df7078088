"""The recording of a journal that a run left, and the scenario that a recording was made of."""

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
    """The recording of a journal that a run left: all its chunks but those that are damaged.

    `meta["missing"]` has a sentence for each missing part. Contacts and object are made of the
    scenario; no arm, controller or plant is, but for a plant that is registered without `truths`.

    Args:
        path: such as unfinished.mcap.
        folder: folder of a custom scenario, see `scenario_of`.

    Raises:
        RecordingError: no such file, nothing in it, or not the journal of a scenario's run.
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
    """The scenario that a recording was made of.

    A recording holds no folders (SECURITY.md): URDFs that its scenario gives by path are looked for
    in `folder`, then beside the recording, then in the working folder.

    Args:
        meta: meta of the recording. path: path of its file. folder: in which the scenario's file
            stands.

    Raises:
        RecordingError: it does not hold a scenario that this version understands, or its URDFs are
            in none of these places.
    """
    try:
        scenario = Scenario.model_validate(meta.get("scenario"))
    except (ScenarioError, ValueError) as error:
        raise RecordingError(f"{path} does not hold the scenario that was run: {error}") from error
    given = [] if folder is None else [Path(folder).resolve()]
    places = dict.fromkeys([*given, path.resolve().parent, Path.cwd()])
    missing = ModelError()
    for place in places:
        placed = scenario.with_source(place / str(meta.get("source")))
        try:
            for urdf in (*(arm.urdf for arm in placed.arms), placed.object.urdf):
                resolve_urdf(urdf, place)
            environment_bodies(placed)
        except ModelError as error:
            missing = error
        else:
            return placed
    raise RecordingError(
        f"{path} needs files of its scenario, which are not in {', '.join(map(str, places))}. Give "
        "the scenario's folder (--folder, or folder= in Python), or start there, or copy them "
        f"beside the recording. ({missing})"
    )
