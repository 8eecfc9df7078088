"""Time the control tick beside its floor and its peers, by size, on the clock.

python -m benchmarks tick | peers | scaling | operational_space | soak | many_runs | vector_env |
franka | compilation
"""

from importlib import import_module
from pathlib import Path
from typing import Annotated

import typer

from benchmarks.measuring import machine, table_from
from osc_contact.errors import InvalidInputError
from osc_contact.lab.cli.console import JsonOption, exit_codes, out, say
from osc_contact.lab.reports.report import write_json
from paper.study import Data

#: Name of each benchmark, which is that of its module, → ticks (rows, edits) where none are given.
BENCHMARKS: dict[str, int] = {
    "tick": 1000,
    "peers": 500,
    "scaling": 300,
    "operational_space": 5000,
    "soak": 1_800_000,
    "many_runs": 20,
    "vector_env": 60,
    "franka": 60_000,
    "compilation": 10,
}

app = typer.Typer(pretty_exceptions_enable=False, add_completion=False)


def run_benchmark(name: str, ticks: int | None = None, tsid_python: Path | None = None) -> Data:
    """Measure: tables, as lists of rows, and numbers by name.

    Args:
        name: one of `BENCHMARKS`.
        ticks: timed ticks of each of its cases, or rounds, runs, steps, edits (default: its own).
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
    found: Data = import_module(f"benchmarks.{name}").measure(count, *more)
    return {"machine": machine(), **found}


@app.command()
def main(
    what: Annotated[str, typer.Argument(help=" | ".join(BENCHMARKS), metavar="WHAT")],
    ticks: Annotated[int | None, typer.Option(min=1, help="timed ticks of each case")] = None,
    tsid_python: Annotated[Path | None, typer.Option(help="peers: TSID's interpreter")] = None,
    json_file: JsonOption = None,
) -> None:
    """Time the control tick beside its floor and its peers, by size, on the clock."""
    with exit_codes():
        data = run_benchmark(what, ticks, tsid_python)
        if json_file is not None:
            write_json(data, json_file)
        say(", ".join(f"{name} {value}" for name, value in data.pop("machine").items()))
        for name, found in data.items():
            if isinstance(found, list):
                out.print(table_from(name, found))
            else:
                say(f"{name}: {found}")


if __name__ == "__main__":
    app()
