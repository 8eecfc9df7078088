"""Run one benchmark: measure, write what was found, give the tables that are printed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from rich.table import Table

from osc_contact.bench.measuring import machine, machine_lines
from osc_contact.errors import InvalidInputError
from osc_contact.runs.report import write_json

__all__ = ["IN_PACKAGE", "Report", "run_benchmark"]

#: Name → module and ticks where none are given. More are in `benchmarks/` of a checkout.
IN_PACKAGE: dict[str, tuple[str, int]] = {"tick": ("osc_contact.bench.ticks", 1000)}


@dataclass(frozen=True)
class Report:
    """What a benchmark found: JSON-able data, lines about the machine, tables."""

    data: dict[str, Any]
    lines: tuple[str, ...]
    tables: list[Table]


def run_benchmark(
    name: str,
    ticks: int | None = None,
    json_file: Path | None = None,
    figure: Path | None = None,
    tsid_python: Path | None = None,
    benchmarks: Mapping[str, tuple[str, int]] = IN_PACKAGE,
) -> Report:
    """Measure, and write what was found.

    Args:
        name: one of `benchmarks`.
        ticks: timed ticks of each of its cases (default: its own).
        json_file, figure: where to write data and picture (PNG and SVG), if anywhere.
        tsid_python: interpreter of TSID's environment, for the peers.
        benchmarks: module and usual ticks of each name.

    Raises:
        InvalidInputError: an unknown name, no ticks, or an interpreter without TSID.
        ImportError: a figure is wanted, but matplotlib is missing.
    """
    if name not in benchmarks:
        more = " (others: `python -m benchmarks` in a checkout)" if benchmarks is IN_PACKAGE else ""
        raise InvalidInputError(f"no benchmark '{name}'; there are {', '.join(benchmarks)}{more}")
    if tsid_python is not None and name != "peers":
        raise InvalidInputError("only the benchmark 'peers' runs TSID; leave --tsid-python out")
    if figure is not None:
        import_module("matplotlib")
    module, usual = benchmarks[name]
    bench = import_module(module)
    count = usual if ticks is None else ticks
    data = bench.measure(count, tsid_python) if name == "peers" else bench.measure(count)
    if json_file is not None:
        write_json(data, json_file)
    if figure is not None:
        bench.draw(data, figure)
    lines = machine_lines(data.get("machine") or machine())
    return Report(data, lines, bench.tables(data))
