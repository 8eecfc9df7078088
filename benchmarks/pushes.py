"""Pushes on the arms of every packaged scenario: do they come back into contact, or stop?

    python benchmarks/pushes.py [--scenario NAME] [--workers 2]

A push is a half sine of force on the wrist of the first arm, off the faces, into or along them,
while the contacts are closed. One row for each is printed; the exit code is 1 where the forces did
not come back within 2 s though the controller did not stop, where an arm still moved then, or a
second after it stopped if that is later, or where a joint was above its speed limit later than
50 ms after the push. Arms whose motors cannot carry them off their faces (limited_rod: 48.0 N for a
weight of 48.07 N) sink back onto these when they are stopped, and a free cart may lean on them
(moving_face): that is reported, and not wrong below a tenth of their speed limits.
"""

import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from functools import cache
from itertools import product
from multiprocessing import get_context

import numpy as np
import typer

import osc_contact as osc
from benchmarks.fault_injection import ClosedLoop
from osc_contact.runs.preflight import least_peak
from osc_contact.scenarios.bodies import CartSpec
from osc_contact.scenarios.hardware import Push

FORCES = (5.0, 20.0, 60.0, 120.0, 200.0)  #: N
DURATIONS = (0.05, 0.1)  #: s
DIRECTIONS = ("off", "into", "along")
BACK_WITHIN = 2.0
SLOW_WITHIN = 0.05  #: s after the push
_STEADY = 0.1  #: s that forces have to be back for
_NEAR = 0.3  #: share of its command that a force is back within; or `_LEAST` N
_LEAST = 1.5
_SETTLING = 1.0  #: s between contact and push
_BRAKED = 1.0  #: s after a stop at which joints rest: they are held half a second after it
_REST = 0.02
_SINKING = 0.1  #: shares of their speed limits below which joints rest, or sink


@dataclass
class Pushed:
    """What became of one push.

    Attributes:
        back: s after the push until all forces were back to stay; None: never.
        stopped: s after its start until the controller stopped; None: it did not.
        late: s after the push at which a joint was last above its speed limit; 0: never.
        speed: largest speed (share of its limit), force: largest contact force (N), since the push.
        wrong, remark: sentences.
    """

    scenario: str
    direction: str
    force: float
    duration: float
    back: float | None = None
    stopped: float | None = None
    late: float = 0.0
    speed: float = 0.0
    largest: float = 0.0
    wrong: list[str] = field(default_factory=list)
    remark: str = ""


def packaged() -> list[str]:
    """The names of the packaged scenarios."""
    return sorted(osc.list_scenarios())


def push_arm(
    name: str, direction: str, force: float, duration: float, changes: Sequence[str] = ()
) -> Pushed:
    """Push once, at rest in contact; look at the two seconds behind it.

    Args:
        changes: of the scenario, as `load_scenario` takes them.
    """
    loop = ClosedLoop(_rig(name, tuple(changes)))
    rig = loop.rig
    dt = loop.dt
    truth = loop.true
    truth.pushes = tuple(push for push in truth.pushes if push.every == 0.0)
    seen = Pushed(name, direction, force, duration)
    begin = None
    first = last = good = 0
    while begin is None or loop.k < last:
        try:
            reference = loop.advance()
        except osc.PlantError as error:
            seen.wrong.append(f"{error}"[:80])
            return seen
        now = truth.truth().alpha
        wanted = np.asarray(reference.alpha_d)
        back = bool((np.abs(now - wanted) <= np.maximum(_NEAR * np.abs(wanted), _LEAST)).all())
        pressed = not len(wanted) or bool((wanted > _LEAST).any())
        ended = good if begin is not None and not pressed else 0  # the task has taken them away
        good = good + 1 if back and pressed else 0
        if begin is None:
            if good * dt >= _SETTLING:
                begin = loop.k * dt
                arm = next(a.name for a in rig.model.arms if a.wrist_sensor is not None)
                push = {"arm": arm, "force": (force * _direction(rig, direction)).tolist()}
                truth.pushes = (*truth.pushes, Push(**push, start=begin, duration=duration))
                first = loop.k + round(duration / dt)
                last = first + round((BACK_WITHIN + _STEADY) / dt)
            elif loop.k * dt > rig.scenario.duration:
                seen.wrong.append("there was no contact to be pushed in")
                return seen
            continue
        since = (loop.k - first) * dt
        speed = loop.speed()
        seen.speed = max(seen.speed, speed)
        seen.largest = max(seen.largest, *map(abs, now), 0.0)
        if speed > 1.0 and since > 0.0:
            seen.late = since
        if seen.stopped is None and loop.controller.state is osc.SafetyState.SAFE_STOP:
            seen.stopped = since + duration
            last = max(last, loop.k + round(_BRAKED / dt))
        if pressed and not back:  # once they were back the task may take them away
            seen.back = None
        elif seen.back is None and (good * dt >= _STEADY or ended > 0):
            seen.back = max((loop.k - first - max(good, ended)) * dt, 0.0)
    if seen.late > SLOW_WITHIN:
        seen.wrong.append(f"a joint above its speed limit {seen.late:.3f} s after the push")
    if seen.stopped is None and seen.back is None:
        seen.wrong.append(f"not back: {now.round(1)} N of {wanted.round(1)}")
    if seen.stopped is not None and speed > _REST:
        moving = f"a joint moves at {speed:.2f} of its speed limit"
        state = rig.state  # needed of the motors' limits, held still off the faces
        need = least_peak(state.G * np.minimum(rig.chain.tau_max, 1e12), state.b_S)
        if need > 1.0 and speed < _SINKING:
            seen.remark = f"{moving}: motors would need {need:.3f} times their limits to carry it"
        elif speed < _SINKING and any(isinstance(body.motion, CartSpec) for body in rig.bodies):
            seen.remark = f"{moving}: a cart leans on it"
        else:
            seen.wrong.append(f"stopped, but {moving}")
    return seen


@cache
def _rig(name: str, changes: tuple[str, ...]) -> osc.Rig:
    scenario = osc.load_scenario(name, list(changes))
    if scenario.plant.exact:  # nothing there is pushed: on MuJoCo it is
        scenario = osc.load_scenario(name, [*changes, "plant.type=mujoco", "plant.step=0.25 ms"])
    return osc.build_rig(scenario)


def _direction(rig: osc.Rig, word: str) -> np.ndarray:
    """(3,) unit vector in the world."""
    into = rig.contact.N[:3].sum(axis=1) if rig.pairs else np.zeros(3)
    if not np.linalg.norm(into) > 0.1:
        into = np.array([0.0, 0.0, -1.0])
    lines = {"into": into, "off": -into, "along": np.cross(into, [0.3, 0.9, 0.4])}
    return lines[word] / np.linalg.norm(lines[word])


def table(rows: Sequence[Pushed]) -> str:
    """One line for each push."""
    lines = [
        "scenario                  direction     N   ms  back s  stop s  late s  speed  force N"
    ]
    for x in rows:
        words = "; ".join(x.wrong) or x.remark
        back, stopped = ("-" if t is None else f"{t:.3f}" for t in (x.back, x.stopped))
        lines.append(
            f"{x.scenario:26}{x.direction:10}{x.force:5.0f}{1e3 * x.duration:5.0f}{back:>8}"
            f"{stopped:>8}{x.late:8.3f}{x.speed:7.2f}{x.largest:9.1f}  {words}"
        )
    return "\n".join(lines)


def main(scenario: list[str] | None = None, workers: int = 2) -> None:
    """Push them all; exit with 1 if anything was wrong."""
    print(table([]))
    wrong = count = 0
    pushes = product(scenario or packaged(), DIRECTIONS, FORCES, DURATIONS)
    with ProcessPoolExecutor(workers, get_context("spawn")) as pool:
        for found in pool.map(push_arm, *zip(*pushes, strict=True)):
            print(table([found]).split("\n")[1], flush=True)
            wrong += bool(found.wrong)
            count += 1
    print(f"{count} pushes, {wrong} of them wrong")
    sys.exit(bool(wrong))


if __name__ == "__main__":
    typer.run(main)
