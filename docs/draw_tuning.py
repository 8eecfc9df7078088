"""The pictures of docs/tuning.md: `python docs/draw_tuning.py` writes docs/images/tuning_*.png."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import osc_contact as osc
from osc_contact.lab.visual.plots import legend, panels, save, style

IMAGES = Path(__file__).parent / "images"
FORCES = [
    "force={left_end: [{type: constant, value: 10 N}, {type: step, value: 5 N, start: 0.6 s}], "
    "right_end: [{type: constant, value: 8 N}]}",
    "motion=[]",
    "duration=1.2 s",
]
HEAVY = ["arms.left.armature=2", "arms.right.armature=2"]
FRICTION = ["plant.joint_friction=0.005", "duration=4 s"]  # of the motors' limits, not known
LINES = ("#B4BAC2", "#0072B2", "#D55E00", "#009E73")


def run(name: str, sets: Sequence[str]) -> osc.Recording:
    """A packaged scenario with some keys changed, as `osc-contact run NAME --set …`."""
    return osc.run(osc.load_scenario(name, list(sets)))


def draw_masses() -> None:
    """First contact and a step, two masses, gains for one mass and for every mass."""
    kinds = {
        "integral 30 1/s, damping 100 N s/m": [],
        "gains={}": ["gains={}"],
    }
    with style():
        figure, axes = panels(4, 1.6)
        masses = (("1–3 kg", []), ("6–29 kg", HEAVY))
        cases = [(m, sets, k, gains) for m, sets in masses for k, gains in kinds.items()]
        for ax, (mass, sets, kind, gains) in zip(axes, cases, strict=True):
            seen = run("two_contact_rod", [*FORCES, *sets, *gains])
            t = seen["t"]
            ax.plot(t, seen["alpha_cmd"], color=LINES[0], lw=3.0)
            for i, name in enumerate(seen.magnitude_names):
                ax.plot(t, seen["alpha_true"][:, i], color=LINES[i + 1], lw=1.2, label=name)
            ax.set(title=f"{mass}: {kind}", ylabel="force (N)", ylim=(0, 22))
        legend(axes[0])
        axes[-1].set(xlabel="time (s)")
        save(figure, IMAGES / "tuning_masses", (".png",))


def draw_force_gains() -> None:
    """Rise, damping ratio and bandwidth, each where it matters."""
    with style():
        figure = Figure(figsize=(8.0, 6.4))
        axes = list(figure.subplots(3, 1))
        for value, colour in zip(("0 s", "0.1 s", "0.25 s"), LINES[1:], strict=True):
            seen = run("two_contact_rod", [*FORCES, *HEAVY, f"gains.force={{rise: {value}}}"])
            axes[0].plot(seen["t"], seen["alpha_true"][:, 1], color=colour, lw=1.0, label=value)
        axes[0].set(title="rise: the right force, while the left one steps at 0.6 s", ylim=(4, 14))
        for value, colour in zip(("0", "0.3", "0.7"), LINES[1:], strict=True):
            sets = ["arms.ur5.armature=0.5", "duration=1.2 s", "motion=[]"]
            seen = run("ur5_wipe", [*sets, f"gains.force={{damping_ratio: {value}}}"])
            axes[1].plot(seen["t"], seen["alpha_true"][:, 1], color=colour, lw=1.0, label=value)
        axes[1].set(title="damping_ratio: ur5_wipe with rotors of 0.5 kg m²", ylim=(0, 14))
        for value, colour in zip(("1 Hz", "5 Hz", "15 Hz"), LINES[1:], strict=True):
            seen = run("two_contact_rod", [*FRICTION, f"gains.force={{bandwidth: {value}}}"])
            error = seen["alpha_true"][:, 0] - seen["alpha_cmd"][:, 0]
            axes[2].plot(seen["t"], error, color=colour, lw=1.0, label=value)
        axes[2].set(title="bandwidth: error under unknown friction of the joints", ylim=(-1, 1))
        _finish(axes, "force (N)")
        save(figure, IMAGES / "tuning_force", (".png",))


def draw_motion_gains() -> None:
    """Frequency and integral time under friction and weights that the model does not know."""
    with style():
        figure, axes = panels(2, 2.0)
        for value, colour in zip(("1.5 Hz", "3.2 Hz", "6 Hz"), LINES[1:], strict=True):
            seen = run("two_contact_rod", [*FRICTION, f"gains.motion={{frequency: {value}}}"])
            axes[0].plot(seen["t"], _error(seen), color=colour, lw=1.0, label=value)
        axes[0].set(title="frequency: unknown friction of the joints")
        for value, colour in zip(("null", "0.4 s", "0.1 s"), LINES[1:], strict=True):
            gains = f"gains.motion={{frequency: 3.2 Hz, integral_time: {value}}}"
            seen = run("two_contact_rod_mismatch", ["duration=4 s", gains])
            axes[1].plot(seen["t"], _error(seen), color=colour, lw=1.0, label=value)
        axes[1].set(title="integral_time: masses believed 20 % too large")
        _finish(axes, "error (mm)")
        save(figure, IMAGES / "tuning_motion", (".png",))


def _error(seen: osc.Recording) -> osc.Array:
    return 1e3 * np.linalg.norm(seen["motion_error"][:, :3], axis=1)


def _finish(axes: Sequence[Axes], unit: str) -> None:
    for ax in axes:
        ax.set(ylabel=unit)
        legend(ax)
    axes[-1].set(xlabel="time (s)")


if __name__ == "__main__":
    draw_masses()
    draw_force_gains()
    draw_motion_gains()
