"""Contacts made and lost: collisions as the plant knows them, and landings from free motion.

`collisions` knocks the rod off its faces again and again (fig. 7); `approach_and_slide` takes it
from free motion to both contacts, slides, and takes it away again.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

import osc_contact as osc
from osc_contact.recorder.judged import judged_ticks
from osc_contact.spatial import Array
from osc_contact.visual import OKABE_ITO, contact_colour, plots
from paper.statements import Answer
from paper.study import Ask, Data, Study, table_of, words_of

KNOCKED = "collisions"
QUIET = ("two_contact_rod", "workcell")
SEEDS = 20  #: landings of `approach_and_slide`
OPEN_S = 0.010  #: a contact re-made after less is one that chatters
SPEED = 0.010  #: m/s; slower than that it is a touch
WITHIN_S = 0.020  #: in which a collision is to be flagged


class Collision(NamedTuple):
    """A contact re-made, as the plant knows it.

    Attributes:
        contact: its number. t: when it was made (s). open_for: s before.
        speed: with which it was met (m/s). power: peak of |V_relᵀΩ_f f_meas| in the next 20 ms (W).
        flagged: s from t to the flag `collision_seen`; None: not within 20 ms.
    """

    contact: int
    t: float
    open_for: float
    speed: float
    power: float
    flagged: float | None


def normal_speeds(recording: osc.Recording) -> Array:
    """(T, r) NᵀV of the true object on faces at rest (m/s)."""
    return np.einsum("tir,ti->tr", recording["N"], recording["twist"])


def collisions(recording: osc.Recording) -> list[Collision]:
    """Every contact that was open for 10 ms or more and re-made at 10 mm/s or more.

    Contacts have one magnitude each, and their faces rest.
    """
    t = recording["t"]
    speeds = normal_speeds(recording)
    power = recording["power_projected"]
    period = 1.0 / float(recording.meta["control_rate_hz"])
    hits = []
    for c, closed in enumerate(recording["closed"].T):
        flags = t[recording["collision_seen"][:, c]]
        for lost, made in pairwise(np.flatnonzero(np.diff(closed.astype(int))) + 1):
            met = float(speeds[made - 2 : made + 1, c].max())
            if not closed[made] or (made - lost) * period < OPEN_S or met < SPEED:
                continue
            at, since = float(t[made]), float(t[lost])
            late = flags[(flags >= at - period) & (flags <= at + WITHIN_S)] - at
            peak = float(np.abs(power[made : made + round(WITHIN_S / period)]).max())
            after = max(float(late[0]), 0.0) if len(late) else None
            hits.append(Collision(c, at, at - since, met, peak, after))
    return sorted(hits, key=lambda hit: hit.t)


def false_alarms(recording: osc.Recording) -> int:
    """Flags of a collision at contacts that were not made in the 20 ms before."""
    before = round(WITHIN_S * float(recording.meta["control_rate_hz"])) + 1
    count = 0
    for closed, flags in zip(recording["closed"].T, recording["collision_seen"].T, strict=True):
        since = np.flatnonzero(flags)[:, None] - np.flatnonzero(np.diff(closed.astype(int)) > 0) - 1
        count += int(np.sum(~((since >= -1) & (since <= before)).any(axis=1)))
    return count


def answers(recording: osc.Recording) -> dict[str, Answer]:
    """What a run of `collisions` says to the paper's statements on fig. 7."""
    t = recording["t"]
    power = np.abs(recording["power_projected"])
    hits = collisions(recording)
    kept = recording["closed"].all(axis=1) & (t > 0.2)
    since = t[:, None] - [hit.t for hit in hits]
    elsewhere = power[kept & ~((since >= -0.005) & (since < 0.1)).any(axis=1)]
    quiet = float(np.sqrt(np.mean(elsewhere**2)))
    most = float(power[~kept].max())
    least = min((hit.power for hit in hits), default=0.0)
    peaks = int(np.sum(elsewhere > 8.0 * quiet))
    return {
        "violated": Answer(
            f"Projected power reaches {most:.2g} W while a contact is open; while "
            f"all are kept its rms is {1e3 * quiet:.2g} mW.",
            most > 8.0 * quiet,
            "8 times the rms",
        ),
        "peaks": Answer(
            f"Each of {len(hits)} collisions has a peak, the least of {least:.2g} W. While all "
            f"contacts are closed there are {peaks} peaks elsewhere; an open "
            "one shows the inertia of the flight.",
            least > 8.0 * quiet and not peaks,
            "peaks above 8 times the rms, within 100 ms of a collision",
        ),
    }


def land(seed: int, changes: Sequence[str] = ()) -> tuple[Data, osc.Recording]:
    """Run `approach_and_slide` from a start of its own: another standoff, another tilt.

    A run succeeds if both contacts are made, stay closed from 50 ms after the later one was made
    until the force is taken back, and are open at the end.

    Args:
        seed: of start, sensors and everything random. changes: "key=value" of the scenario.

    Returns:
        JSON-able what was found, with `success`, standoff off the faces (m) and tilt about the y
        axis (rad) at the start; the recording.
    """
    ranges = ([0.003, -0.01, -0.02], [0.008, 0.01, 0.02])
    standoff, tilt, shift = np.random.default_rng([seed, 7]).uniform(*ranges).tolist()
    scenario = osc.load_scenario("approach_and_slide", [f"tare.standoff={standoff!r}", *changes])
    slide, *rest = (move.model_dump() for move in scenario.motion)
    begin, lean = ({"type": "constant", "value": value} for value in (shift, tilt))
    slide["signals"] = [*slide["signals"], begin]
    tilted = {"kind": "angular", "direction": [0.0, 1.0, 0.0], "signals": [lean]}
    r = osc.run(scenario.replaced(motion=[slide, *rest, tilted]), seed=seed)
    verdict = osc.metrics(r)
    made = list(verdict["first_contact_s"].values())
    command = r["alpha_cmd"]
    held = (r["t"] > max(t or 0.0 for t in made) + 0.05) & (command > 0.0).any(axis=1)
    rates = np.abs(np.diff(r["tau"], axis=0)) / list(r.meta["effort_limits"].values())
    data = {
        "seed": seed,
        "standoff_m": standoff,
        "tilt_rad": tilt,
        "success": bool(r["closed"][held].all() and held.any() and not r["closed"][-1].any()),
        "made_s": made,
        "peak_over_command": float(r["alpha_true"].max() / command.max()),
        "force_rms_rel": max(
            force["rms_error_rel"] or np.inf for force in verdict["force"].values()
        ),
        "torque_rate": float(rates.max() * r.meta["control_rate_hz"]),
        "torque_rate_limit": float(r.meta["scenario"]["control"]["life"]["torque_rate"]),
    }
    return data, r


def draw_collisions(recording: osc.Recording) -> Figure:
    """Fig. 7: total and projected power as in fig. 6.

    Triangles: collisions as the plant knows them; the monitor flagged the filled ones in 20 ms.
    Shaded: a contact is open, and N assumes what is not there.
    """
    hits = collisions(recording)
    kept: Any = recording["closed"].all(axis=1)
    kept[0] = True  # the forces build up in the first tick
    figure = plots.power(recording, kept)
    ax = figure.axes[1]
    high = 0.95 * ax.get_ylim()[1]
    shaded: Any = figure.axes[0].get_legend()
    if hits:
        shaded.texts[0].set_text("a contact is open")
    with plots.style():
        for flagged, face in ((True, OKABE_ITO["black"]), (False, "white")):
            at = [hit.t for hit in hits if (hit.flagged is not None) == flagged]
            label = f"flagged ({len(at)})" if flagged else f"not flagged ({len(at)})"
            ax.plot(at, [high] * len(at), "v", ms=5, mfc=face, mec="black", label=label)
        ax.legend(title="collisions", loc="center right")
    return figure


def draw_landing(runs: Sequence[osc.Recording]) -> Figure:
    """Forces of the first run, and the true ones of all others."""
    figure = plots.contact_forces(runs[0], judged_ticks(runs[0])[0])
    for one in runs[1:]:
        for i, force in enumerate(one["alpha_true"].T):
            figure.axes[i].plot(one["t"], force, color=contact_colour(i), lw=0.6)
    return figure


def fig7(ask: Ask) -> Study:
    """Fig. 7: collisions and what the monitor makes of them; false alarms of long quiet runs.

    Args:
        ask: duration of every run (s), else 10 s and 60 s of the quiet ones; changes of
            `collisions`.
    """
    ask.tell(KNOCKED)
    scenario = osc.load_scenario(KNOCKED, ask.changes)
    knocked = osc.run(scenario, duration=ask.duration, seed=ask.seed)
    quiet = {}
    for name in QUIET:
        ask.tell(name)
        scenario = osc.load_scenario(name)
        quiet[name] = osc.run(scenario, duration=ask.lasting(60.0), seed=ask.seed)
    hits = collisions(knocked)
    flagged = [hit.flagged for hit in hits if hit.flagged is not None]
    alarms = {
        name: {"count": false_alarms(r), "duration_s": float(r["t"][-1])}
        for name, r in {KNOCKED: knocked, **quiet}.items()
    }
    data: Data = {
        "collisions": [hit._asdict() for hit in hits],
        "flagged": len(flagged),
        "slowest_flag_s": max(flagged, default=None),
        "false_alarms": alarms,
    }
    rows = {"collisions flagged within 20 ms": f"{len(flagged)} of {len(hits)}"}
    if flagged:
        rows["slowest flag"] = f"{1e3 * max(flagged):.0f} ms after the collision"
    if hits:
        met = [1e3 * hit.speed for hit in hits]
        peaks = [hit.power for hit in hits]
        rows["met at"] = f"{min(met):.0f} … {max(met):.0f} mm/s"
        rows["peaks of projected power"] = f"{min(peaks):.3f} … {max(peaks):.3f} W"
    for name, r in quiet.items():
        rms = float(np.sqrt(np.mean(r["power_projected"][r["t"] >= 1.0] ** 2)))
        rows[f"projected power of {name}, rms"] = f"{rms:.2g} W"
    for name, one in alarms.items():
        rows[f"false alarms in {one['duration_s']:.0f} s of {name}"] = str(one["count"])
    title = "fig. 7: contacts lost and made again, on mujoco"
    table = table_of(title, "quantity; value", rows.items())
    return Study({"fig7": draw_collisions(knocked)}, table, data, answers(knocked))


def landing_study(ask: Ask) -> Study:
    """Landings from many starts, one for each seed."""
    data = []
    runs = []
    for seed in range(ask.seed, ask.seed + SEEDS):
        ask.tell(f"seed {seed} of {SEEDS}")
        found, recording = land(seed, ask.all_changes())
        data.append(found)
        runs.append(recording)
    rows = [
        f"{row['seed']}; {1e3 * row['standoff_m']:.1f} mm; {1e3 * row['tilt_rad']:.1f} mrad; "
        f"{', '.join(words_of(t, '{:.2f}') for t in row['made_s'])} s; "
        f"{row['peak_over_command']:.3f}; {row['force_rms_rel']:.2%}; "
        f"{row['torque_rate']:.1f} of {row['torque_rate_limit']:g} 1/s; "
        f"{'yes' if row['success'] else 'no'}"
        for row in data
    ]
    won = sum(row["success"] for row in data)
    worst = max(row["peak_over_command"] for row in data)
    rows.append(f"all; ; ; ; ≤ {worst:.3f}; ; ; {won} of {len(data)}")
    table = table_of(
        "approach_and_slide on mujoco",
        "seed; standoff; tilt; contacts made at; peak / command; force error, rms; "
        "largest torque rate; success",
        rows,
    )
    figures = {"approach_and_slide": draw_landing(runs)}
    figures["approach_and_slide_torques"] = plots.torques(runs[0])
    return Study(figures, table, {"runs": data})
