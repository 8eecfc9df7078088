"""Fig. 7: contacts lost and made again, collisions as in the plant's truth.

`collisions` knocks the rod off its faces again and again.
"""

from collections.abc import Callable, Sequence
from functools import partial
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

import osc_contact as osc
from osc_contact.lab.visual import OKABE_ITO, plots
from paper.statements import Answer
from paper.study import Ask, Study, table_of

KNOCKED = "collisions"
QUIET = ("two_contact_rod", "workcell")
CHANNELS = ("t", "N", "twist", "closed", "collision_seen", "power_total", "power_projected")
OPEN_S = 0.010  #: a contact re-made after less is one that chatters
SPEED = 0.010  #: m/s; slower than that it is a touch
WITHIN_S = 0.020  #: in which a collision is to be flagged


class Collision(NamedTuple):
    """A contact re-made, in the plant's truth.

    Attributes:
        contact: number of the contact.
        t: time at which it was made (s).
        speed: speed with which it was met (m/s).
        power: peak of |V_relᵀΩ_f f_meas| in the next 20 ms (W).
        flagged: s from t to the flag `collision_seen`; None: not within 20 ms.
    """

    contact: int
    t: float
    speed: float
    power: float
    flagged: float | None


def collisions(recording: osc.Recording) -> list[Collision]:
    """Every contact that was open for 10 ms or more and re-made at 10 mm/s or more.

    Contacts have one magnitude each, and their faces rest.
    """
    t = recording["t"]
    speeds = np.einsum("tir,ti->tr", recording["N"], recording["twist"])  # faces rest
    power = recording["power_projected"]
    period = 1.0 / float(recording.meta["control_rate_hz"])
    hits = []
    for c, closed in enumerate(recording["closed"].T):
        flags = t[recording["collision_seen"][:, c]]
        for lost, made in pairwise(np.flatnonzero(np.diff(closed.astype(int))) + 1):
            met = float(speeds[made - 2 : made + 1, c].max())
            if not closed[made] or (made - lost) * period < OPEN_S or met < SPEED:
                continue
            at = float(t[made])
            late = flags[(flags >= at - period) & (flags <= at + WITHIN_S)] - at
            peak = float(np.abs(power[made : made + round(WITHIN_S / period)]).max())
            after = max(float(late[0]), 0.0) if len(late) else None
            hits.append(Collision(c, at, met, peak, after))
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
    """Answers of a run of `collisions` to the paper's statements on fig. 7."""
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


def draw_collisions(recording: osc.Recording) -> Figure:
    """Fig. 7: total and projected power as in fig. 6.

    Triangles: collisions in the plant's truth; the monitor flagged the filled ones in 20 ms.
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
            label = f"{'' if flagged else 'not '}flagged ({len(at)})"
            ax.plot(at, [high] * len(at), "v", ms=5, mfc=face, mec="black", label=label)
        ax.legend(title="collisions", loc="center right")
    return figure


def run(scenario: str, changes: Sequence[str], duration: float, seed: int) -> osc.Recording:
    """Run a scenario; of its recording, what fig. 7 is made of.

    Args:
        scenario: scenario with these changes.
        duration: s.
        seed: of everything random.
    """
    recording = osc.run(osc.load_scenario(scenario, changes), duration=duration, seed=seed)
    return osc.Recording(recording.meta, {name: np.array(recording[name]) for name in CHANNELS})


def runs(ask: Ask) -> dict[str, Callable[[], osc.Recording]]:
    """The runs of fig. 7, by the names of their scenarios."""
    return {
        name: partial(
            run, name, ask.changes if name == KNOCKED else (), ask.lasting(10.0), ask.seed
        )
        for name in (KNOCKED, *QUIET)
    }


def fig7(ask: Ask) -> Study:
    """Fig. 7: collisions and what the monitor makes of them; false alarms of quiet runs.

    Args:
        ask: duration of every run (s), else 10 s; changes of `collisions`.
    """
    recordings = ask.results(runs(ask))
    knocked = recordings[KNOCKED]
    hits = collisions(knocked)
    flagged = [hit.flagged for hit in hits if hit.flagged is not None]
    alarms = {name: false_alarms(r) for name, r in recordings.items()}
    data = {"collisions": [hit._asdict() for hit in hits], "false_alarms": alarms}
    rows = {"collisions flagged within 20 ms": f"{len(flagged)} of {len(hits)}"}
    if flagged:
        rows["slowest flag"] = f"{1e3 * max(flagged):.0f} ms after the collision"
    if hits:
        least = min(hit.power for hit in hits)
        rows["least peak of projected power"] = f"{least:.3f} W"
    for name, count in alarms.items():
        rows[f"false alarms in {recordings[name]['t'][-1]:.0f} s of {name}"] = str(count)
    table = table_of("fig. 7: contacts on mujoco", "quantity; value", rows.items())
    return Study({"fig7": draw_collisions(knocked)}, table, data, answers(knocked))
