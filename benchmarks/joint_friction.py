"""Joint friction that differs from the controller's model: rms force errors in MuJoCo.

    python -m benchmarks.joint_friction [--only PART] [--workers 2]
    python -m benchmarks.joint_friction --folder robosuite/models/assets/robots --only MJCF

Each arm presses 10 N on a plate and draws a circle on it at 0.5 Hz, with default gains. Coulomb and
viscous friction of its joints and their rotors are those of the plant; the controller's model has
the friction times a factor (0: unknown, where `learning` is asked for). Judged from one second of
motion on.
With a folder of MJCF arms that nobody here wrote (a checkout or wheel of robosuite, no dependency):
the same with the joints of their files, without and with rotors of 0.5 kg m², judged as by the
verdict. Where the plate stands follows from the posture that `osc-contact new` takes.
"""

from collections.abc import Iterable
from functools import cache
from itertools import product
from pathlib import Path
from tempfile import mkdtemp
from typing import Any, NamedTuple

import numpy as np
import typer

import osc_contact as osc
from benchmarks.measuring import side_by_side
from benchmarks.random_tasks import spring_wall
from osc_contact.contacts.pairs.pair import triad
from osc_contact.lab.plants.mujoco import MujocoPlant
from osc_contact.lab.rig.rig import PLANTS, Rig
from osc_contact.lab.runs import poses
from osc_contact.lab.sweeps.rows import without_logged_doubts

MJCF = ("iiwa", "jaco", "kinova3", "panda", "sawyer", "spot_arm", "ur5e", "xarm7")  #: folders
TIPS = {"ur10": "tool0", "xarm7": "link7", "panda": "panda_hand_tcp"}
BELIEVED = {factor: [f"model_error.joint_friction={factor}"] for factor in (1.0, 0.5, 1.5, 0.0)}
HALF = BELIEVED[0.5]
JUDGED_FROM = 2.0  #: s, of the drafted scenarios: first contact, and one second of motion
#: Friction, damping and rotors of both rods' joints.
TWO_ARMS = {
    "two_contact_rod": ("friction=0.3", "damping=0.2", "armature=0.1"),
    "dual_panda_rod": ("friction=1", "damping=2", "armature=0.1"),
}
ROTORS = ("friction=1.0", "damping=2.0", "armature=0.1")
#: Encoders (bit), noise of the wrists (N), the most that the error may be; 3 ms of delay.
SENSORS = ((20, 0.05, 1.5), (16, 0.5, 3.0))

SPRINGY = 5e4  #: N/m, of a wall that the controller takes for rigid


def _stribeck(rig: Rig, seed: int) -> Any:
    """MuJoCo with joint friction that falls to 60 % as a joint begins to move: v_s = 0.03 rad/s."""
    plant: Any = PLANTS["mujoco"](rig, seed)
    stiction = plant.model.dof_frictionloss.copy()

    def command(tau: np.ndarray, duration: float) -> None:
        falling = 0.6 + 0.4 * np.exp(-((plant.data.qvel / 0.03) ** 2))
        plant.model.dof_frictionloss[:] = falling * stiction
        MujocoPlant.command(plant, tau, duration)

    plant.command = command
    return plant


class Case(NamedTuple):
    """Case of the benchmark: changes of the scenario, and the largest rms error (%)."""

    name: str
    scenario: str
    changes: tuple[str, ...]
    most: float

    @without_logged_doubts()
    def run(self) -> tuple[Any, ...]:
        """Force error, rms and peak, share of contact, largest overshoot (%), of motion, verdict.

        Of motion: the rms error of the position (mm), the largest one of the orientation (mrad).

        Packaged scenarios are judged as by the verdict, without steps.
        """
        # at run time: importing this module leaves the register of plants as it is
        osc.register_plant("stribeck")(_stribeck)
        try:
            scenario = osc.load_scenario(_file(self.scenario), list(self.changes))
            recording = osc.run(scenario, check=lambda rig: [])  # it doubts unknown friction
        except osc.OscContactError as refusal:
            return (*np.full(6, np.nan), str(refusal)[:60])
        verdict = osc.metrics(recording)
        judged = recording["t"] >= JUDGED_FROM
        away = np.linalg.norm(recording["motion_error"][judged].reshape(-1, 2, 3), axis=2).T
        motion = (1e3 * np.sqrt(np.mean(away[0] ** 2)), 1e3 * away[1].max())
        if self.scenario in TIPS:
            force = recording["alpha_true"][judged]
            commanded = recording["alpha_cmd"][judged]
            error = (force - commanded) / np.abs(commanded).max()
            found = (np.sqrt(np.mean(error**2)), np.abs(error).max(), np.mean(force > 0.0))
        else:
            worst = [
                max(one[key] or np.nan for one in verdict["force"].values())
                for key in ("rms_error_rel", "peak_error_rel")
            ]
            found = (*worst, min(verdict["contact_fraction"].values()))
        overshoot = max((step["overshoot_rel"] for step in verdict["steps"]), default=np.nan)
        numbers = 100.0 * np.array((*found, overshoot))
        return (*numbers, *motion, verdict["task"]["word"])


@cache
def _file(scenario: str) -> str:
    """A packaged scenario, or the draft for a robot that presses 10 N."""
    if scenario not in TIPS and not scenario.endswith(".xml"):
        return scenario
    target = Path(mkdtemp()) / "task.yaml"
    arm = poses.arm_of(scenario, TIPS.get(scenario, "right_hand"))
    target.write_text(poses.draft(scenario, arm, poses.Press.parse("Z=10"), None, target))
    return str(target)


def move_on_wall(scenario: str, frequency: float = 0.5, moves: int = 2) -> tuple[str, ...]:
    """Changes of a drafted scenario: 10 N at once, and a circle (or a line) in the wall's plane.

    Args:
        scenario: the robot.
        frequency: Hz.
        moves: 1: to and fro; 2: a circle.
    """
    contact: Any = osc.load_scenario(_file(scenario)).contacts[0]
    axes = zip(triad(np.array(contact.face.normal)).T[:moves], (0, 90), strict=False)
    signals = ", ".join(
        f"{{kind: linear, direction: [{x}, {y}, {z}], signals: [{{type: sine, ramp: 1 s, "
        f"amplitude: 20 mm, frequency: {frequency} Hz, phase: {phase} deg}}]}}"
        for (x, y, z), phase in axes
    )
    return (f"motion=[{signals}]", "force.ball=[{type: constant, value: 10 N}]", "gains={}")


def _joints(scenario: str, numbers: Iterable[str]) -> tuple[str, ...]:
    arms = osc.load_scenario(_file(scenario)).arms
    return tuple(f"arms.{arm.name}.{number}" for arm in arms for number in numbers)


def _noisy(bits: int, newtons: float) -> str:
    encoder = f"encoder: {{rate: 1 kHz, angle: {{resolution: {2.0 * np.pi / 2**bits}}}}}"
    wrist = (
        f"wrist: {{rate: 1 kHz, delay: 3 ms, force: {{noise: {newtons}}}, "
        f"torque: {{noise: {0.02 * newtons}}}}}"
    )
    return f"sensors={{{encoder}, {wrist}}}"


def cases() -> list[Case]:
    """Rows of the table, by part: the rods of two arms, then each arm on its plate."""
    out = []
    for name, numbers in TWO_ARMS.items():
        for factor, believed in BELIEVED.items():
            changes = (*_joints(name, numbers), *believed)
            out.append(Case(f"two arms {name} x{factor:g}", name, changes, 1.5))
        unknown = ("plant.joint_friction=0.02",)
        out.append(Case(f"two arms {name} unknown 2 % of the limit", name, unknown, 2.5))
    for arm in TIPS:
        out += [Case(name, arm, changes, most) for name, most, changes in _of_arm(arm)]
    return out + _as_drafted("xarm7") + _drawn(12)


def _as_drafted(arm: str) -> list[Case]:
    """A task as `new` writes it, with all of the URDF; motions that the wall does not permit."""
    file = _file(arm)
    contact: Any = osc.load_scenario(file).contacts[0]
    along, _, normal = triad(np.array(contact.face.normal)).T
    sine = "signals: [{type: sine, amplitude: 20 mm, frequency: 0.25 Hz, ramp: 1 s}]"
    motions = {"untouched": None, "along the normal": normal, "45 deg into it": along - normal}
    out = []
    for name, direction in motions.items():
        changes = ["duration=6 s"]
        if direction is not None:
            changes.append(f"motion=[{{kind: linear, direction: {direction.tolist()}, {sine}}}]")
        out.append(Case(f"as new {arm} {name}", arm, tuple(changes), 2.0))
        rotors = _joints(arm, ["armature=0.05"])
        out.append(Case(f"as new {arm} {name}, rotors", arm, (*changes, *rotors), 1.0))
    return out


def _drawn(count: int) -> list[Case]:
    """Arms, motions, friction, damping, rotors and what is believed of them, at random."""
    rng = np.random.default_rng(0)
    out = []
    for i in range(count):
        arm = str(rng.choice(list(TIPS)))
        motion = move_on_wall(arm, rng.uniform(0.1, 0.8), int(rng.integers(1, 3)))
        numbers = zip(
            ("friction", "damping", "armature"),
            rng.uniform([0.3, 0.3, 0.05], [1.5, 3.0, 0.2]),
            strict=True,
        )
        joints = _joints(arm, (f"{key}={value}" for key, value in numbers))
        believed = f"model_error.joint_friction={rng.uniform(0.5, 1.5)}"
        out.append(
            Case(f"random {i} {arm}", arm, (*motion, *joints, believed, "duration=5 s"), 1.0)
        )
    return out


def _of_arm(arm: str) -> Iterable[tuple[str, float, tuple[str, ...]]]:
    """Name, most error and changes of each case of an arm."""

    def slide(frequency: float = 0.5, moves: int = 2) -> tuple[str, ...]:
        return (*move_on_wall(arm, frequency, moves), "duration=5 s")

    rotors = _joints(arm, ROTORS)
    for factor, believed in BELIEVED.items():
        yield (f"rotors {arm} x{factor:g}", 1.0, (*slide(), *rotors, *believed))
        if factor in (1.0, 1.5):
            yield (f"bare {arm} x{factor:g}", 2.5, (*slide(), *rotors[:2], *believed))
    forgotten = _joints(arm, ("armature=0.5",))
    changes = (*slide(), *forgotten, "model_error.armature=0")
    yield (f"forgotten rotors {arm}", 1.0, changes)
    for frequency, most in ((0.5, 1.0), (1.0, 1.5), (2.0, 2.0)):
        yield (
            f"reversals {arm} {frequency:g} Hz x0.5",
            most,
            (*slide(frequency, 1), *rotors, *HALF),
        )
    yield (f"5 mm/s {arm} x0.5", 0.3, (*slide(0.04), *rotors, *HALF))
    for share, most in ((0.005, 1.2), (0.02, 2.5)):
        changes = (*slide(), f"plant.joint_friction={share}")
        yield (f"unknown {arm} {100 * share:g} % of the limit", most, changes)
    slowly = (*slide(0.2, 1), "plant.joint_friction=0.02")
    yield (f"unknown {arm} 2 % of the limit, to and fro at 0.2 Hz", 2.5, slowly)
    for frequency, moves in product((0.2, 0.5, 1.0), (1, 2)):
        falling = (
            *_joints(arm, ["friction=0"]),
            "plant.type=stribeck",
            "plant.joint_friction=0.01",
        )
        name = f"Stribeck 1 % {arm} {frequency:g} Hz, {'line' if moves == 1 else 'circle'}"
        yield (name, 5.0, (*slide(frequency, moves), *falling))
    drafted = osc.load_scenario(_file(arm))
    springy = (
        *slide(0.3, 1),
        *_joints(arm, ["friction=0", "armature=0.1"]),
        "plant.type=stribeck",
        "plant.joint_friction=0.015",
        *spring_wall(drafted, SPRINGY),
    )
    yield (f"springy wall {arm}, Stribeck 1.5 %", 5.0, springy)
    for bits, newtons, most in SENSORS:
        name = f"noise {arm} {bits} bit, {newtons} N, 3 ms"
        yield (name, most, (*slide(), *rotors, *HALF, _noisy(bits, newtons)))
    late = "sensors={wrist: {rate: 1 kHz, delay: 10 ms}}"
    yield (f"late wrist {arm} 10 ms", 5.0, (*slide(), *rotors, *HALF, late))
    still = (*slide()[1:3], *rotors, *HALF, "motion=[]")
    step = (
        "force.ball=[{type: constant, value: 10 N}, "
        "{type: minimum_jerk, value: 5 N, start: 2 s, duration: 0.2 s}]"
    )
    yield (f"standing {arm} x0.5", 3.0, (*still, "duration=10 s"))
    yield (f"force step {arm} x0.5", 3.0, (*still, step, "duration=4 s"))


def _of_mjcf(folder: Path) -> Iterable[Case]:
    for name in MJCF:
        robot = str(folder / name / "robot.xml")
        moves = (*move_on_wall(robot), "duration=3 s")
        yield Case(f"MJCF {name}", robot, moves, 0.5)
        for inertia in (0.0, 0.5):
            rotors = _joints(robot, [f"armature={inertia}"])
            yield Case(f"MJCF {name}, rotors {inertia}", robot, (*moves, *rotors), 0.5)


def main(only: str = "", workers: int = 2, folder: Path | None = None) -> None:
    """Print the table.

    Args:
        only: rows whose name contains this.
    """
    others = [] if folder is None else _of_mjcf(folder)
    rows = [case for case in (*cases(), *others) if only in case.name]
    print(
        f"{'case':52}   rms %   limit   peak %  contact %  overshoot %  rms mm  peak mrad  verdict"
    )
    found = side_by_side(Case.run, [(case,) for case in rows], workers)
    for case, values in zip(rows, found, strict=True):
        rms, peak, closed, overshoot, away, turned, word = values
        print(
            f"{case.name:52} {rms:7.4f}  {case.most:6.2f}  {peak:7.1f}  {closed:9.1f}"
            f"  {overshoot:11.1f}  {away:6.3f}  {turned:9.2f}  {word}",
            flush=True,
        )


if __name__ == "__main__":
    typer.run(main)
