"""Impedance and admittance beside the decoupled law: 10 N on walls that references miss or not.

python -m benchmarks.impedance [--picture FILE]
"""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
import typer
from matplotlib.figure import Figure
from rich.console import Console

import osc_contact as osc
from benchmarks.hybrid_cases import CASES, MUJOCO, RADIUS, scenario_of
from osc_contact.lab.visual.plots import legend, save, style
from paper.study import table_of

FORCE = 10.0
SLIDES_FROM = 2.0  #: s
LAWS: dict[str, Callable[[], osc.Laws]] = {
    "decoupled": osc.Laws,
    "impedance, 1000 N/m": osc.impedance,
    "impedance, 200 N/m": lambda: osc.impedance((200.0, 100.0)),
    "admittance": lambda: osc.admittance(stiffness=(0.0, 1e3, 1e3, 100.0, 100.0, 100.0)),
}


class Wall(NamedTuple):
    """Wall on which the arm presses.

    Attributes:
        surface: MuJoCo's solref and solimp, which make it stiff or soft; empty: the default.
        motion: motion of the whole wall, as in a scenario; None: it is at rest.
        environment: kind of environment in the model of the law.
        offsets: distances behind the surface at which references end (m).
        gains: gains of the decoupled law.
    """

    surface: Mapping[str, Any]
    motion: Mapping[str, Any] | None = None
    environment: str = "known"
    offsets: tuple[float, ...] = (0.0, 3e-3, -3e-3)
    gains: Mapping[str, Any] = {}


SOFT = {"solimp": (0.9, 0.9, 5e-4)}
CART = {"type": "cart", "direction": [1, 0, 0], "mass": 0.5, "stiffness": 2e4, "damping": 40.0}
WALLS = {
    "hard": Wall({}),
    "soft": Wall({"solref": (0.05, 1.0), **SOFT}),
    "very soft": Wall({"solref": (0.1, 1.0), **SOFT}),
    "0.5 kg on a spring, unknown": Wall({}, CART, "ignored", (0.0,)),
    "the same, at 5 Hz": Wall({}, CART, "ignored", (0.0,), {"force": {"bandwidth": 5.0}}),
    "0.5 kg on a spring, known": Wall({}, CART, offsets=(0.0,)),
}


def run(law: Callable[[], osc.Laws], wall: Wall, offset: float) -> osc.Recording:
    """From 5 mm off the wall onto it, 10 N, then along it and back at 0.5 Hz.

    Args:
        law: name in `LAWS`.
        wall: name in `WALLS`.
        offset: distance behind its surface at which the reference ends (m).
    """
    onto = {"type": "minimum_jerk", "start": 0.3, "value": offset, "duration": 0.5}
    along = {"type": "sine", "amplitude": 0.06, "frequency": 0.5, "start": SLIDES_FROM, "ramp": 0.5}
    ways = (([1.0, 0.0, 0.0], onto), ([0, 1, 0], along))
    (body,) = scenario_of(CASES[0]).environment
    scenario = scenario_of(
        CASES[0],
        environment=[{**body.model_dump(), "motion": wall.motion}],
        model_error={"environment": wall.environment},
        force={"finger": [{**onto, "value": FORCE, "duration": 1.0}]},
        motion=[{"kind": "linear", "direction": d, "signals": [s]} for d, s in ways],
        gains=wall.gains,
        control={"rate": 1000.0, "life": {}},
        tare={"duration": 0.3, "standoff": 0.005, "approach": 0.5},
        plant=MUJOCO | wall.surface,
        duration=4.0,
    )
    return osc.run(scenario.replaced(laws=law))


def judge(seen: osc.Recording) -> tuple[float, float, float]:
    """Largest force until it slides, rms error then (N), rms error along the wall (mm)."""
    force = seen["alpha_true"][:, 0]
    later = seen["t"] > SLIDES_FROM
    off = 1e3 * np.linalg.norm(seen["motion_error"][later, 1:3], axis=1)
    rms, error = (float(np.sqrt(np.mean(x * x))) for x in (force[later] - FORCE, off))
    return (float(force[~later].max()), rms, error)


def draw(seen: Mapping[tuple[str, float], Mapping[str, osc.Recording]], path: Path) -> None:
    """Forces over time, on some of the walls.

    Args:
        seen: results by wall and offset, then by law.
        path: path of the picture.
    """
    shown = {
        ("hard", 0.0): "hard wall, reference on it",
        ("hard", 3e-3): "hard wall, reference 3 mm behind it",
        ("very soft", -3e-3): "very soft wall, reference 3 mm before it",
        ("0.5 kg on a spring, unknown", 0.0): "0.5 kg on a spring that the law does not know of",
    }
    with style():
        figure = Figure(figsize=(8.0, 8.0))
        axes = figure.subplots(len(shown), 1, sharex=True)
        for ax, (case, title) in zip(axes, shown.items(), strict=True):
            for name, one in seen[case].items():
                ax.plot(one["t"], one["alpha_true"][:, 0], lw=1.0, label=name)
            ax.set(title=title, ylabel="force (N)")
        legend(axes[0])
        axes[-1].set(xlabel="time (s)")
        save(figure, path.with_suffix(""), (".png",))


def main(
    picture: Annotated[Path | None, typer.Option(help="where to draw the forces (.png)")] = None,
) -> None:
    """Land, press and slide under each law, on each wall, references on it and off it."""
    seen = {}
    rows = []
    for name, wall in WALLS.items():
        for offset in wall.offsets:
            runs = {law: run(make, wall, offset) for law, make in LAWS.items()}
            seen[name, offset] = runs
            cells = [" / ".join(f"{x:.3g}" for x in judge(one)) for one in runs.values()]
            rows.append((name, f"{1e3 * offset:+.0f}", *cells))
            if len(wall.offsets) > 1 and offset == 0.0:
                last = runs["decoupled"]
                depth = last["pose"][-1, 0] - (CASES[0].wall[0] - RADIUS)
                print(f"{name}: {1e-3 * last['alpha_true'][-1, 0] / depth:.2g} kN/m at {FORCE:g} N")
    titles = "; ".join(("wall", "off (mm)", *LAWS))
    title = "landing (N) / force rms (N) / along the wall, rms (mm)"
    Console(width=150).print(table_of(title, titles, rows))
    if picture is not None:
        draw(seen, picture)


if __name__ == "__main__":
    typer.run(main)
