"""Errors at the goals of all cases: `python -m benchmarks.hybrid_cases`."""

from __future__ import annotations

from rich.console import Console
from rich.table import Table

import osc_contact as osc
from benchmarks.hybrid_cases import CASES, judge, judge_samples, scenario_of

SAMPLES = 16


def main() -> None:
    """Run every case, alone and with what is not known; print the errors."""
    columns = ("case", "goal", "force", "error", "along the wall", "turn")
    alone = Table(*columns, title="exact model, no friction")
    rough = Table(*columns, title=f"largest of {SAMPLES}: masses, friction")
    for case in CASES:
        one = judge(case, osc.run(scenario_of(case)))
        for table, errors in ((alone, one), (rough, judge_samples(case, SAMPLES).max(axis=0))):
            for i, (goal, (force, place, turn)) in enumerate(zip(case.goals, errors, strict=True)):
                table.add_row(case.name, str(i + 1), f"{goal.force:g} N", f"{force:.2f} N",
                              f"{1e3 * place:.1f} mm", f"{1e3 * turn:.1f} mrad")  # fmt: skip
    console = Console()
    console.print(alone)
    console.print(rough)


if __name__ == "__main__":
    main()
