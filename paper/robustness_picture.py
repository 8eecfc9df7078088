"""The robustness study as a figure and a table."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter
from rich.table import Table

from osc_contact.visual import OKABE_ITO
from osc_contact.visual.style import style
from paper.robustness import (
    LABELS,
    LAWS,
    QUANTITIES,
    SHARES,
    TITLES,
    Robustness,
)

__all__ = ["draw", "tabulate"]


def tabulate(found: Robustness) -> Table:
    """Tasks done and quantiles of both errors: a row for each case and law."""
    cases = found.as_dict()["cases"]
    samples = next(iter(cases.values()))["samples"]
    shares = " / ".join(f"{100 * share:g} %" for share in SHARES)
    table = Table(
        "not as believed", "law", "tasks done", *QUANTITIES.values(),
        title=f"two_contact_rod on mujoco, {samples} samples of each case: {shares} of runs below",
    )  # fmt: skip
    for name, case in cases.items():
        for law in LAWS:
            told = case[law]
            errors = [
                " / ".join("none" if x is None else f"{x:.3g}" for x in told[k]) for k in QUANTITIES
            ]
            table.add_row(TITLES[name], LABELS[law], f"{told['success_rate']:.1%}", *errors)
    return table


def draw(found: Robustness) -> Figure:
    """The share of runs below an error: a column for each case, forces above, motions below."""
    colours = dict(zip(LAWS, ("blue", "vermillion", "orange"), strict=True))
    with style():
        figure = Figure(figsize=(10.0, 5.2))
        axes = figure.subplots(2, len(found.rows), sharex="row", sharey=True)
        for row, (quantity, label) in zip(axes, QUANTITIES.items(), strict=True):
            for ax, name in zip(row, found.rows, strict=True):
                for law in LAWS:
                    errors = found.errors(name, law, quantity)
                    share = (np.arange(len(errors)) + 1) / len(errors)
                    ax.step(
                        errors,
                        share,
                        where="post",
                        color=OKABE_ITO[colours[law]],
                        label=LABELS[law],
                    )
                ax.set_xscale("log")
                ax.set_xlabel(label)
            row[0].set_ylabel("share of runs")
            row[0].yaxis.set_major_formatter(PercentFormatter(1.0))
        for ax, name in zip(axes[0], found.rows, strict=True):
            ax.set_title(TITLES[name])
        axes[0, 0].legend(loc="upper left")
    return figure
