"""The benchmark runs as a program and writes what it prints."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

import osc_contact as osc
from osc_contact.control.controller import Controller
from osc_contact.errors import InvalidInputError
from osc_contact.experiments.timing import time_parts, time_tick

PROGRAM = Path(__file__).parents[1] / "benchmarks" / "control_loop.py"


def start(*words: str | Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-W", "error", str(PROGRAM), *map(str, words)]
    return subprocess.run(command, capture_output=True, text=True, timeout=120)


def test_benchmark_writes_table_json_and_figure(tmp_path: Path) -> None:
    done = start("--ticks", "8", "--json", tmp_path / "b.json", "--figure", tmp_path / "b.png")
    assert done.returncode == 0, done.stderr
    result = json.loads((tmp_path / "b.json").read_text())
    about = result["machine"]
    assert about["cpu"] and about["cores"] >= 1 and about["python"] == sys.version.split()[0]
    assert about["packages"]["osc-contact"] == osc.__version__
    assert {"pin", "numpy", "numba"} <= set(about["packages"])
    (case,) = result["cases"].values()
    assert set(case) == {
        "rounds", "tick_us", "floor_us", "ratio", "inside_us", "readable_us", "parts_us"
    }  # fmt: skip
    assert case["rounds"] == 8
    for times in (case["tick_us"], case["floor_us"], *case["parts_us"].values()):
        assert 0.0 < times["p50"] <= times["p99"] <= times["p99_9"] <= times["max"]
    assert case["ratio"] == pytest.approx(case["tick_us"]["p50"] / case["floor_us"]["p50"])
    assert len(case["parts_us"]) == len(Controller.STAGES)
    for name in (*case["parts_us"], "floor: computeAllTerms", about["cpu"], f"pin {_pin(about)}"):
        assert name in done.stdout
    assert (tmp_path / "b.png").stat().st_size > 10000


def _pin(about: dict[str, dict[str, str]]) -> str:
    return about["packages"]["pin"]


def test_benchmark_refuses_bad_input(tmp_path: Path) -> None:
    for words, message in (
        (("--ticks", "0"), "0 rounds"),
        (("--scenario", "nope"), "no packaged scenario"),
        (("--ticks", "many"), "invalid int"),
    ):
        done = start(*words, "--json", tmp_path / "b.json")
        assert done.returncode == 2 and message in done.stderr and not done.stdout
    assert not (tmp_path / "b.json").exists()


def test_parts_add_up_to_about_a_tick() -> None:
    times = time_parts(osc.build_rig(osc.load_scenario("two_contact_rod")), 60)
    assert all(part.shape == times.readable.shape == (60,) for part in times.parts.values())
    total = sum(part.min() for part in times.parts.values())
    assert 0.4 * times.readable.min() < total < 1.3 * times.readable.min()
    inside = sum(part.min() for part in times.inside.values())
    assert 0.4 * times.tick.min() < inside < 1.1 * times.tick.min()
    assert times.tick.min() < 0.1 * times.readable.min()
    assert times.tick.min() < 4.0 * times.floor.min()


def test_time_tick_gives_the_documented_numbers() -> None:
    (row,) = time_tick(["two_contact_rod"], 3).values()
    assert set(row) == {"tick_p50_us", "floor_p50_us", "ratio", "p99_9_us"}
    with pytest.raises(InvalidInputError, match="0 rounds"):
        time_tick(["two_contact_rod"], 0)
