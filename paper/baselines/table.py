"""The comparison with the baselines as a table."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from rich.table import Table

__all__ = ["comparison_table"]

_Numbers = list[float | None]


def comparison_table(result: Mapping[str, Any]) -> Table:
    """baselines.json: a column for each law, and how many times smaller the first one's number is
    than the best of the others'."""
    laws = list(result["laws"].values())
    table = Table(
        "cross-talk", *(law["label"] for law in laws), "best / ours",
        title=f"{result['scenario']}: ours and selection laws with their best frames",
    )  # fmt: skip
    for words, numbers in _comparison_rows(result, laws):
        known = [x for x in numbers[1:] if x is not None]
        ours = numbers[0]
        ratio = f"{min(known) / ours:.3g}" if known and ours else "-"
        shown = ["failed" if x is None else f"{x:.3g}" for x in numbers]
        table.add_row(words, *shown, ratio)
    return table


def _comparison_rows(
    result: Mapping[str, Any], laws: Sequence[Mapping[str, Any]]
) -> Iterator[tuple[str, _Numbers]]:
    yield (
        "rigid, one instant: force → motion (1)",
        [law["measured"]["force_to_motion"] for law in laws],
    )
    yield (
        "rigid, one instant: motion → force (1)",
        [law["measured"]["motion_to_force"] for law in laws],
    )
    force, motion = f"{result['force_step_N']:g} N", f"{1e3 * result['motion_step_m']:g} mm"
    for plant in ("rigid", "mujoco"):
        answers = [law[plant] for law in laws]
        tasks = [x["task"] for x in answers]
        yield (
            f"{plant}, {force} step: object moves (µm)",
            [1e6 * max(x["force_to_motion_m"]) for x in answers],
        )
        yield (
            f"{plant}, {motion} step: force error (N)",
            [max(x["motion_to_force_N"]) for x in answers],
        )
        yield (
            f"{plant}, whole task: force rms (N)",
            [
                max(x["rms_error_N"] for x in t["force"].values()) if "force" in t else None
                for t in tasks
            ],
        )
        for unit, scaled in (("m", "mm"), ("rad", "mrad")):
            yield (
                f"{plant}, whole task: motion rms ({scaled})",
                [1e3 * t["motion"][f"rms_error_{unit}"] if "motion" in t else None for t in tasks],
            )
