"""Time the control tick beside its floor and its peers, by size, on the clock.

python -m benchmarks tick | peers | scaling | operational_space | soak | many_runs | vector_env |
franka
"""

from importlib import import_module
from typing import Annotated

import typer

from benchmarks.measuring import machine, table_from
from osc_contact.console import JsonOption, exit_codes, out, say
from osc_contact.errors import InvalidInputError
from osc_contact.runs.report import write_json
from paper.study import Data

#: Name of each benchmark, which is that of its module, → ticks where none are given.
BENCHMARKS: dict[str, int] = {
    "tick": 1000,
    "peers": 500,
    "scaling": 300,
    "operational_space": 5000,
    "soak": 1_800_000,
    "many_runs": 20,
    "vector_env": 60,
    "franka": 60_000,
}

app = typer.Typer(pretty_exceptions_enable=False, add_completion=False)


def run_benchmark(name: str, ticks: int | None = None) -> Data:
    """Measure: tables, as lists of rows, and numbers by name.

    Args:
        name: one of `BENCHMARKS`.
        ticks: timed ticks of each of its cases, or rounds, runs, steps (default: its own).

    Raises:
        InvalidInputError: an unknown name, or no ticks.
    """
    if name not in BENCHMARKS:
        raise InvalidInputError(f"no benchmark '{name}'; there are {', '.join(BENCHMARKS)}")
    count = BENCHMARKS[name] if ticks is None else ticks
    if count < 1:
        raise InvalidInputError(f"{count} ticks give no time; take 1 or more")
    found: Data = import_module(f"benchmarks.{name}").measure(count)
    return {"machine": machine(), **found}


@app.command()
def main(
    what: Annotated[str, typer.Argument(help=" | ".join(BENCHMARKS), metavar="WHAT")],
    ticks: Annotated[int | None, typer.Option(min=1, help="timed ticks of each case")] = None,
    json_file: JsonOption = None,
) -> None:
    """Time the control tick beside its floor and its peers, by size, on the clock."""
    with exit_codes():
        data = run_benchmark(what, ticks)
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
