"""Contacts made and lost: collisions as the plant knows them, and landings from free motion.

`collisions` knocks the rod off its faces again and again (fig. 7); `approach_and_slide` takes it
from free motion to both contacts, slides, and takes it away again.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from osc_contact.recorder import Recording
from osc_contact.runs.run import run
from osc_contact.scenarios import load_scenario
from osc_contact.spatial import Array
from paper.statements import Answer

__all__ = [
    "Collision", "Landing", "answers", "collisions", "effort_limits", "false_alarms",
    "fig7", "land", "landings", "normal_speeds",
]  # fmt: skip

KNOCKED, QUIET = "collisions", ("two_contact_rod", "workcell")
SEEDS = 20  #: landings of `approach_and_slide`
OPEN_S = 0.010  #: a contact re-made after less is one that chatters
SPEED = 0.010  #: m/s; slower than that it is a touch
WITHIN_S = 0.020  #: in which a collision is to be flagged


@dataclass(frozen=True)
class Collision:
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


def normal_speeds(recording: Recording) -> Array:
    """(T, r) NᵀV of the true object on faces at rest (m/s)."""
    return np.asarray(np.einsum("tir,ti->tr", recording["N"], recording["twist"]))


def collisions(recording: Recording) -> list[Collision]:
    """Every contact that was open for 10 ms or more and re-made at 10 mm/s or more.

    Contacts have one magnitude each, and their faces rest.
    """
    t, speeds, power = recording["t"], normal_speeds(recording), recording["power_projected"]
    period = 1.0 / float(recording.meta["control_rate_hz"])
    hits = []
    for c, closed in enumerate(recording["closed"].T):
        edges = np.flatnonzero(np.diff(closed.astype(int))) + 1
        flags = t[recording["collision_seen"][:, c]]
        for lost, made in pairwise(edges):
            met = float(speeds[made - 2 : made + 1, c].max())
            if not closed[made] or (made - lost) * period < OPEN_S or met < SPEED:
                continue
            late = flags[(flags >= t[made] - period) & (flags <= t[made] + WITHIN_S)]
            peak = np.abs(power[made : made + round(WITHIN_S / period)]).max()
            after = float(max(late[0] - t[made], 0.0)) if len(late) else None
            away = float(t[made] - t[lost])
            hits.append(Collision(c, float(t[made]), away, met, float(peak), after))
    return sorted(hits, key=lambda hit: hit.t)


def false_alarms(recording: Recording) -> int:
    """Flags of a collision at contacts that were not made in the 20 ms before."""
    period = 1.0 / float(recording.meta["control_rate_hz"])
    before, count = round(WITHIN_S / period) + 1, 0
    for closed, flags in zip(recording["closed"].T, recording["collision_seen"].T, strict=True):
        made = np.flatnonzero(np.diff(closed.astype(int)) > 0) + 1
        for k in np.flatnonzero(flags):
            count += not ((made <= k + 1) & (made >= k - before)).any()
    return count


def fig7(
    duration: float | None = None,
    seed: int = 0,
    changes: Sequence[str] = (),
    tell: Callable[[str], None] | None = None,
) -> tuple[Recording, dict[str, Recording]]:
    """A run in which contacts are lost again and again, and long ones in which none is.

    Args:
        duration: s of every run; default: 10 s, and 60 s of the quiet ones.
        seed: of everything random. changes: "key=value" of `collisions`.
        tell: called with what runs next.
    """
    tell = tell or (lambda _: None)
    tell(KNOCKED)
    knocked = run(load_scenario(KNOCKED, changes), duration=duration, seed=seed)
    quiet = {}
    for name in QUIET:
        tell(name)
        quiet[name] = run(load_scenario(name), duration=duration or 60.0, seed=seed)
    return knocked, quiet


def answers(recording: Recording) -> dict[str, Answer]:
    """What a run of `collisions` says to the paper's statements on fig. 7."""
    t, power, hits = recording["t"], np.abs(recording["power_projected"]), collisions(recording)
    kept = recording["closed"].all(axis=1) & (t > 0.2)
    near = np.zeros(len(t), dtype=bool)
    for hit in hits:
        near |= (t >= hit.t - 0.005) & (t < hit.t + 0.1)
    quiet = float(np.sqrt(np.mean(power[kept & ~near] ** 2)))
    least = min((hit.power for hit in hits), default=0.0)
    peaks = kept & (power > 8.0 * quiet)
    return {
        "violated": Answer(
            f"Projected power reaches {power[~kept].max():.2g} W while a contact is open; while "
            f"all are kept its rms is {1e3 * quiet:.2g} mW.",
            bool(power[~kept].max() > 8.0 * quiet),
            "8 times the rms",
        ),
        "peaks": Answer(
            f"Each of {len(hits)} collisions has a peak, the least of {least:.2g} W. While all "
            f"contacts are closed there are {int((peaks & ~near).sum())} peaks elsewhere; an open "
            "one shows the inertia of the flight.",
            least > 8.0 * quiet and not (peaks & ~near).any(),
            "peaks above 8 times the rms, within 100 ms of a collision",
        ),
    }


@dataclass(frozen=True)
class Landing:
    """One run of `approach_and_slide`.

    Attributes:
        seed: of the run. standoff: m off the faces at the start. tilt: rad about the y axis.
        recording: of it.
    """

    seed: int
    standoff: float
    tilt: float
    recording: Recording

    def as_dict(self) -> dict[str, Any]:
        """JSON-able: what was found, and `success`.

        A run succeeds if both contacts are made, stay closed from 50 ms after the later one was
        made until the force is taken back, and are open at the end.
        """
        r = self.recording
        t, closed, force = r["t"], r["closed"], r["alpha_true"]
        command = r["alpha_cmd"]
        leave = int(np.flatnonzero((command > 0.0).any(axis=1))[-1])
        first = [int(np.argmax(c)) if c.any() else len(t) for c in closed.T]
        settled = max(first) + round(0.05 * float(r.meta["control_rate_hz"]))
        kept = settled < leave and bool(closed[settled:leave].all())
        steps = np.abs(np.diff(r["tau"], axis=0)).max(axis=0)
        rate = (
            steps
            * float(r.meta["control_rate_hz"])
            / np.array(list(r.meta["effort_limits"].values()))
        )
        judged = slice(settled + 150, leave)
        error = force[judged] - command[judged]
        return {
            "seed": self.seed,
            "standoff_m": self.standoff,
            "tilt_rad": self.tilt,
            "success": kept and not bool(closed[-1].any()),
            "made_s": [float(t[k]) if k < len(t) else None for k in first],
            "peak_over_command": float(force.max() / command.max()),
            "force_rms_rel": float(np.sqrt(np.mean(error**2)) / command.max()) if kept else None,
            "torque_rate": float(rate.max()),
            "torque_rate_limit": float(r.meta["scenario"]["control"]["life"]["torque_rate"]),
        }


def effort_limits(recording: Recording) -> Array:
    """(n_a,) effort limits."""
    return np.array(list(recording.meta["effort_limits"].values()))


def land(seed: int, changes: Sequence[str] = ()) -> Landing:
    """Run `approach_and_slide` from a start of its own: another standoff, another tilt.

    Args:
        seed: of start, sensors and everything random. changes: "key=value" of the scenario.
    """
    rng = np.random.default_rng([seed, 7])
    standoff, tilt = float(rng.uniform(0.003, 0.008)), float(rng.uniform(-0.01, 0.01))
    shift = float(rng.uniform(-0.02, 0.02))
    scenario = load_scenario("approach_and_slide", [f"tare.standoff={standoff!r}", *changes])
    slide, *rest = (move.model_dump() for move in scenario.motion)
    begin, lean = ({"type": "constant", "value": value} for value in (shift, tilt))
    slide["signals"] = [*slide["signals"], begin]
    tilted = {"kind": "angular", "direction": [0.0, 1.0, 0.0], "signals": [lean]}
    scenario = scenario.replaced(motion=[slide, *rest, tilted])
    return Landing(seed, standoff, tilt, run(scenario, seed=seed))


def landings(
    seeds: Sequence[int],
    changes: Sequence[str] = (),
    tell: Callable[[str], None] | None = None,
) -> list[Landing]:
    """`land` for each seed.

    Args:
        seeds: one run each.
        changes: "path.to.key=value" of the scenario.
        tell: called with what runs next.
    """
    runs = []
    for seed in seeds:
        if tell is not None:
            tell(f"seed {seed} of {len(seeds)}")
        runs.append(land(seed, changes))
    return runs
