"""Learn to polish, above our law and above another: `python -m benchmarks.polishing`."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.console import Console
from rich.table import Table

from benchmarks.polishing.jacobian_transpose import SOFT, STIFF, SelectionRows
from benchmarks.polishing.learner import learn
from benchmarks.polishing.task import (
    EDGES,
    MEAN,
    Passes,
    best_forces,
    make_env,
    polish,
)
from osc_contact.spatial import Array

KNOTS = np.linspace(EDGES[0], EDGES[-1], 12)  #: m, where a policy says its forces
SLOW, FAST = 1.4, 0.7  #: s, of a pass: while learning; and twice as fast, not seen while learning
UNSEEN, JUDGED = 10**6, 16  #: seed of passes that no learner has seen, and how many
LAWS = {
    "ours": lambda env: None,
    "Jᵀ, soft": partial(SelectionRows, gains=SOFT),
    "Jᵀ, stiff": partial(SelectionRows, gains=STIFF),
}


def teach(law: str, rows: int, generations: int, seed: int, say: Any = None) -> tuple[Array, Array]:
    """Policy (12,) that is learnt above a law, and its unevenness at each generation."""
    env = make_env(rows, SLOW)
    LAWS[law](env)
    return learn(
        lambda policies, episodes: polish(env, policies, episodes).uneven,
        np.full(len(KNOTS), MEAN), 4.0, rows, generations, seed,
        lambda k, cost: say and say(f"{law}, seed {seed}, generation {k}: {cost:.1%}"),
    )  # fmt: skip


def judge(law: str, policy: Array, seconds: float) -> Passes:
    """Passes with masses that were not met while learning."""
    env = make_env(JUDGED, seconds)
    LAWS[law](env)
    return polish(env, np.tile(policy, (JUDGED, 1)), UNSEEN)


def main(
    rows: Annotated[int, typer.Option(min=4, help="policies of a generation")] = 40,
    generations: Annotated[int, typer.Option(min=1)] = 12,
    seeds: Annotated[int, typer.Option(min=1, help="learners above our law")] = 2,
    figure: Annotated[Path | None, typer.Option(help="also draw it (PNG)")] = None,
) -> None:
    """Learn, judge, print, draw."""
    console = Console()
    runs = [("ours", seed) for seed in range(seeds)] + [("Jᵀ, stiff", 0)]
    learnt = {}
    with console.status("learning") as status:
        for law, seed in runs:
            learnt[law, seed] = teach(law, rows, generations, seed, status.update)
    table = Table(
        "law", "policy", "slow: uneven", "off the path", "fast: uneven", "off the path",
        title=f"{JUDGED} passes with masses not met while learning",
    )  # fmt: skip
    depths = {}
    policies = {("ours", "15 N everywhere"): np.full(len(KNOTS), MEAN)}
    policies |= {(law, f"learnt, seed {seed}"): found[0] for (law, seed), found in learnt.items()}
    policies |= {(law, "best, hardness told"): best_forces(KNOTS) for law in LAWS}
    for (law, name), policy in policies.items():
        cells = []
        for seconds in (SLOW, FAST):
            seen = judge(law, policy, seconds)
            depths[law, name, seconds] = seen.depth
            cells += [f"{seen.uneven.mean():.1%}", f"{1e3 * seen.off.mean():.2f} mm"]
        table.add_row(law, name, *cells)
    console.print(table)
    if figure is not None:
        draw(learnt, depths, figure)


def draw(
    learnt: dict[tuple[str, int], tuple[Array, Array]],
    depths: dict[tuple[str, str, float], Array],
    path: Path,
) -> None:
    """Learning curves; forces found beside the best ones; depths before and after."""
    from matplotlib.figure import Figure

    from osc_contact.visual.style import save, style

    with style():
        figure = Figure(figsize=(10.0, 3.2))
        curves, forces, depth = figure.subplots(1, 3)
        colours = dict(zip(LAWS, ("#0072B2", "#E69F00", "#D55E00"), strict=True))
        for (law, seed), (policy, curve) in learnt.items():
            label = law if seed == 0 else None
            curves.plot(100 * curve, color=colours[law], label=label)
            if law == "ours":
                forces.plot(1e3 * KNOTS, policy, color=colours[law], lw=0.9,
                            label="learnt" if seed == 0 else None)  # fmt: skip
        curves.set(title="unevenness of the mean policy", xlabel="generation", ylabel="%",
                   yscale="log")  # fmt: skip
        forces.plot(1e3 * KNOTS, best_forces(KNOTS), "k--", lw=1.2, label="best, hardness told")
        forces.set(title="force by place", xlabel="place (mm)", ylabel="N", ylim=(0, None))
        middle = 500 * (EDGES[1:] + EDGES[:-1])
        for name, colour, label in (("15 N everywhere", "#999999", "before"),
                                    ("learnt, seed 0", "#0072B2", "after")):  # fmt: skip
            for i, one in enumerate(depths["ours", name, SLOW]):
                depth.plot(middle, one, color=colour, lw=0.7, label=label if i == 0 else None)
        depth.set(title=f"depth of {JUDGED} passes, 1: as wanted", xlabel="place (mm)",
                  ylim=(0, None))  # fmt: skip
        for ax in (curves, forces, depth):
            ax.legend()
        save(figure, path.with_suffix(""), (".png",))


if __name__ == "__main__":
    typer.run(main)
