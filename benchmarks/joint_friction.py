"""Joint friction that the controller believes wrongly: rms error of the contact force, in MuJoCo.

    python -m benchmarks.joint_friction [--only PART] [--workers 2]

Each arm presses 10 N on a plate and draws a circle on it at 0.5 Hz, with default gains. Coulomb and
viscous friction of its joints and their rotors are those of the plant; the controller's model has
the friction times a factor (0: unknown). Judged from one second of motion on.
"""

from __future__ import annotations

import argparse
import logging
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import mkdtemp

import numpy as np

import osc_contact as osc
from osc_contact.contacts.pairs.pair import triad
from osc_contact.runs import poses
from osc_contact.runs.drafts import Press, draft

TIPS = {"ur10": "tool0", "xarm7": "link7", "panda": "panda_hand_tcp"}
BELIEVED = (1.0, 0.5, 1.5, 0.0)
JUDGED_FROM = 2.0  #: s: first contact, and one second of motion


@dataclass(frozen=True)
class Case:
    """One run: what is changed, and the most its rms error may be (%)."""

    name: str
    scenario: str
    changes: tuple[str, ...]
    most: float
    begin: float | None = JUDGED_FROM  #: s; None: as the verdict judges, without steps

    def run(self) -> tuple[float, float, float, str]:
        """Rms and peak of the force error (%), share of contact (%), verdict."""
        logging.disable(logging.WARNING)
        try:
            changes = ["control.joint_friction.learning=true", *self.changes]
            recording = osc.run(osc.load_scenario(_file(self.scenario), changes))
        except osc.OscContactError as error:
            return np.nan, np.nan, np.nan, str(error)[:60]
        verdict = osc.metrics(recording)
        word = verdict["task"]["word"]
        if self.begin is None:
            force = verdict["force"].values()
            rms, peak = (
                100.0 * max(one[key] or np.nan for one in force)
                for key in ("rms_error_rel", "peak_error_rel")
            )
            return rms, peak, 100.0 * min(verdict["contact_fraction"].values()), word
        judged = recording["t"] >= self.begin
        if not judged.any():
            return np.nan, np.nan, np.nan, word
        wanted = recording["alpha_cmd"][judged]
        error = (recording["alpha_true"][judged] - wanted) / np.abs(wanted).max()
        rms = 100.0 * float(np.sqrt(np.mean(error**2)))
        closed = 100.0 * float(np.mean(recording["alpha_true"][judged] > 0.0))
        return rms, 100.0 * float(np.abs(error).max()), closed, word


@cache
def _file(scenario: str) -> str:
    """A packaged scenario, or the draft for a robot."""
    if scenario not in TIPS:
        return scenario
    path = Path(mkdtemp()) / f"{scenario}.yaml"
    path.write_text(
        draft(scenario, poses.arm_of(scenario, TIPS[scenario]), Press.parse("Z=10"), None, path)
    )
    return str(path)


def _slide(arm: str, frequency: float = 0.5, straight: bool = False) -> tuple[str, ...]:
    """10 N at once, and a circle or a straight slide to and fro."""
    normal = np.array(osc.load_scenario(_file(arm)).contacts[0].face.normal)
    moves = [
        f"{{kind: linear, direction: [{x}, {y}, {z}], signals: [{{type: sine, ramp: 1 s, "
        f"amplitude: 20 mm, frequency: {frequency} Hz, phase: {phase} deg}}]}}"
        for (x, y, z), phase in zip(triad(normal)[:, :2].T, (0, 90), strict=True)
    ]
    return (
        f"motion=[{', '.join(moves[: 1 if straight else 2])}]",
        "force.ball=[{type: constant, value: 10 N}]",
        "gains={}",
        "duration=5 s",
    )


def _joints(arm: str, friction: float, damping: float, armature: float | None) -> tuple[str, ...]:
    name = osc.load_scenario(_file(arm)).arms[0].name
    given = [f"arms.{name}.friction={friction}", f"arms.{name}.damping={damping}"]
    if armature is not None:
        given.append(f"arms.{name}.armature={armature}")
    return tuple(given)


#: Encoders, noise of the wrists and delay of all sensors.
SENSORS = {
    "20 bit, 0.05 N, 3 ms": (20, 0.05, 1.5),
    "16 bit, 0.5 N, 3 ms": (16, 0.5, 3.0),
}


def _noisy(bits: int, newtons: float) -> str:
    encoder = f"encoder: {{rate: 1 kHz, angle: {{resolution: {2.0 * np.pi / 2**bits}}}}}"
    wrist = (
        f"wrist: {{rate: 1 kHz, delay: 3 ms, force: {{noise: {newtons}}}, "
        f"torque: {{noise: {0.02 * newtons}}}}}"
    )
    return f"sensors={{{encoder}, {wrist}}}"


def two_arms() -> list[Case]:
    """The rods of two arms, friction known, half known, believed too large, unknown."""
    given = {
        "two_contact_rod": ("friction=0.3", "damping=0.2", "armature=0.1"),
        "dual_panda_rod": ("friction=1", "damping=2", "armature=0.1"),
    }
    out = []
    for name, numbers in given.items():
        arms = [arm.name for arm in osc.load_scenario(name).arms]
        all_joints = tuple(f"arms.{arm}.{number}" for arm in arms for number in numbers)
        for factor in BELIEVED:
            changes = (*all_joints, f"model_error.joint_friction={factor}")
            out.append(Case(f"two arms {name} x{factor:g}", name, changes, 1.5, None))
        unknown = ("plant.joint_friction=0.02",)
        out.append(Case(f"two arms {name} unknown 2 % of the limit", name, unknown, 2.5, None))
    return out


def at_rest(arm: str) -> list[Case]:
    """Standing, and a step of the force after two seconds of it."""
    still = ("motion=[]", "gains={}", "model_error.joint_friction=0.5")
    still += _joints(arm, 1.0, 2.0, 0.1)
    hold = (*still, "force.ball=[{type: constant, value: 10 N}]", "duration=10 s")
    step = (
        "force.ball=[{type: constant, value: 10 N}, "
        "{type: minimum_jerk, value: 5 N, start: 2 s, duration: 0.2 s}]"
    )
    return [
        Case(f"standing {arm} x0.5", arm, hold, 3.0),
        Case(f"force step {arm} x0.5", arm, (*still, step, "duration=4 s"), 3.0),
    ]


def cases() -> list[Case]:
    """Rows of the table, by part."""
    out = two_arms()
    for arm in TIPS:
        plain = _slide(arm)
        out.append(Case(f"clean {arm}", arm, (*plain, *_joints(arm, 0.0, 0.0, 0.1)), 0.3))
        for factor in BELIEVED:
            believed = f"model_error.joint_friction={factor}"
            rotor = (*plain, *_joints(arm, 1.0, 2.0, 0.1), believed)
            out.append(Case(f"rotors {arm} x{factor:g}", arm, rotor, 1.0))
            if factor in (1.0, 1.5):
                bare = (*plain, *_joints(arm, 1.0, 2.0, None), believed)
                out.append(Case(f"bare {arm} x{factor:g}", arm, bare, 2.5))
        for frequency, most in ((0.5, 1.0), (1.0, 1.5), (2.0, 2.0)):
            turning = (*_slide(arm, frequency, straight=True), *_joints(arm, 1.0, 2.0, 0.1))
            half = (*turning, "model_error.joint_friction=0.5")
            out.append(Case(f"reversals {arm} {frequency:g} Hz x0.5", arm, half, most))
        slow = (*_slide(arm, 0.04), *_joints(arm, 1.0, 2.0, 0.1), "model_error.joint_friction=0.5")
        out.append(Case(f"5 mm/s {arm} x0.5", arm, slow, 0.3))
        for share, most in ((0.005, 1.2), (0.02, 2.5)):
            unknown = (*plain, f"plant.joint_friction={share}")
            out.append(Case(f"unknown {arm} {100 * share:g} % of the limit", arm, unknown, most))
        half = (*plain, *_joints(arm, 1.0, 2.0, 0.1), "model_error.joint_friction=0.5")
        for what, (bits, newtons, most) in SENSORS.items():
            out.append(Case(f"noise {arm} {what}", arm, (*half, _noisy(bits, newtons)), most))
        out += at_rest(arm)
    return out


def main(given: list[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", default="", help="rows whose name contains this")
    parser.add_argument("--workers", type=int, default=2)
    chosen = parser.parse_args(given)
    rows = [case for case in cases() if chosen.only in case.name]
    print(f"{'case':40} rms %  wanted   peak %  contact %  verdict")
    with ProcessPoolExecutor(chosen.workers) as pool:
        for case, (rms, peak, closed, word) in zip(rows, pool.map(Case.run, rows), strict=True):
            print(
                f"{case.name:40} {rms:5.2f}  {case.most:6.2f}  {peak:7.1f}  {closed:9.1f}  {word}",
                flush=True,
            )


if __name__ == "__main__":
    main()
