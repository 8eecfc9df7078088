"""Time the control tick beside its floor and its peers, by size, on the clock, in a whole run.

python -m benchmarks tick | peers | scaling | jitter | law | operational_space |
simulation | many_runs | vector_env | soak | franka
"""

from importlib import import_module
from pathlib import Path
from typing import Annotated

import typer

from benchmarks.measuring import Report, machine, machine_lines
from osc_contact.console import JsonOption, exit_codes, out, say
from osc_contact.errors import InvalidInputError
from osc_contact.runs.report import write_json

#: Name of each benchmark, which is that of its module, → ticks where none are given.
BENCHMARKS: dict[str, int] = {
    "tick": 1000,
    "peers": 500,
    "scaling": 300,
    "jitter": 4000,
    "law": 2000,
    "operational_space": 5000,
    "simulation": 10000,
    "soak": 1_800_000,
    "many_runs": 20,
    "vector_env": 60,
    "franka": 60_000,
}

app = typer.Typer(pretty_exceptions_enable=False, add_completion=False)


def run_benchmark(
    name: str,
    ticks: int | None = None,
    json_file: Path | None = None,
    tsid_python: Path | None = None,
) -> Report:
    """Measure, and write what was found.

    Args:
        name: one of `BENCHMARKS`.
        ticks: timed ticks of each of its cases, or rounds, runs, steps (default: its own).
        json_file: where to write data, if anywhere.
        tsid_python: interpreter of TSID's environment, for the peers.

    Raises:
        InvalidInputError: an unknown name, no ticks, or an interpreter without TSID.
    """
    if name not in BENCHMARKS:
        raise InvalidInputError(f"no benchmark '{name}'; there are {', '.join(BENCHMARKS)}")
    if tsid_python is not None and name != "peers":
        raise InvalidInputError("only the benchmark 'peers' runs TSID; leave --tsid-python out")
    count = BENCHMARKS[name] if ticks is None else ticks
    if count < 1:
        raise InvalidInputError(f"{count} ticks give no time; take 1 or more")
    more = () if tsid_python is None else (tsid_python,)
    found = import_module(f"benchmarks.{name}").measure(count, *more)
    report = Report({"machine": machine(), **found.data}, found.tables)
    if json_file is not None:
        write_json(report.data, json_file)
    return report


@app.command()
def main(
    what: Annotated[str, typer.Argument(help=" | ".join(BENCHMARKS), metavar="WHAT")],
    ticks: Annotated[int | None, typer.Option(min=1, help="timed ticks of each case")] = None,
    tsid_python: Annotated[Path | None, typer.Option(help="peers: TSID's interpreter")] = None,
    json_file: JsonOption = None,
) -> None:
    """Time the control tick beside its floor and its peers, by size, on the clock, in a run."""
    with exit_codes():
        report = run_benchmark(what, ticks, json_file, tsid_python)
        say("\n".join(machine_lines(report.data["machine"])))
        for table in report.tables:
            out.print(table)


if __name__ == "__main__":
    app()
