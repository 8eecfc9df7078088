"""The benchmarks run as programs, write what they print, and time what they say they time."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from time import perf_counter, sleep

import numpy as np
import pytest

import osc_contact as osc
from osc_contact.control.controller import Controller
from osc_contact.errors import InvalidInputError
from osc_contact.experiments.benchmarks import jitter, peers, scaling, simulation
from osc_contact.experiments.benchmarks.cases import CASES
from osc_contact.experiments.benchmarks.engines import constraint_dynamics, mujoco_state
from osc_contact.experiments.benchmarks.measuring import take_turns
from osc_contact.experiments.benchmarks.program import run_benchmark
from osc_contact.experiments.benchmarks.random_arms import (
    KINDS,
    contact_of,
    faces_of,
    random_rig,
)
from osc_contact.experiments.benchmarks.textbook import TextbookLaw
from osc_contact.experiments.timing import time_parts, time_tick

PROGRAMS = Path(__file__).parents[1] / "benchmarks"
SPREAD = {"p50", "p99", "p99_9", "max"}


def start(*words: str | Path, program: str = "control_loop") -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-W", "error", str(PROGRAMS / f"{program}.py"), *map(str, words)]
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


def run_program(name: str, ticks: int, folder: Path) -> tuple[dict, str]:
    """(JSON, printed) of a program that also draws."""
    json_file, figure = folder / "b.json", folder / "b.png"
    words = ("--ticks", str(ticks), "--json", json_file, "--figure", figure)
    done = start(*words, program=name)
    assert done.returncode == 0, done.stderr
    assert figure.stat().st_size > 10000
    result = json.loads(json_file.read_text())
    assert result["machine"]["cpu"] in done.stdout
    return result, done.stdout


def sane(times: dict[str, float]) -> bool:
    return 0.0 < times["p50"] <= times["p99"] <= times["p99_9"] <= times["max"]


def test_peers_program(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(peers.TSID_PYTHON, raising=False)
    result, printed = run_program("peers", 2, tmp_path)
    assert set(result["cases"]) == {"two_contact_rod", "one_panda"}
    for case in result["cases"].values():
        assert len(case["peers_us"]) == 8 and all(map(sane, case["peers_us"].values()))
        tick = case["peers_us"]["tick"]["p50"]
        for name, times in case["peers_us"].items():
            assert case["ratio"][name] == pytest.approx(times["p50"] / tick)
    assert set(result["tsid"]) == {"missing"} and "pip install" in printed


def test_scaling_program(tmp_path: Path) -> None:
    result, _ = run_program("scaling", 2, tmp_path)
    sizes = [(row["kind"], row["arms"]) for row in result["arms"]]
    assert sizes == [(k, n) for k in (*KINDS, "mixed") for n in range(1, 9)]
    assert [row["r"] for row in result["ranks"]] == list(range(7))
    assert [(row["contacts"], row["r"]) for row in result["contacts"]] == [
        (1, 1), (2, 2), (4, 4), (8, 6), (16, 6), (2, 1), (4, 1), (8, 1), (16, 1)
    ]  # fmt: skip
    for row in (*result["arms"], *result["ranks"], *result["contacts"]):
        assert row["tick_p50_us"] > 0.0 and row["floor_p50_us"] > 0.0
        assert row["tick_per_arm_us"] == pytest.approx(row["tick_p50_us"] / row["arms"])


def test_jitter_program(tmp_path: Path) -> None:
    result, _ = run_program("jitter", 16, tmp_path)
    assert set(result["rates"]) == {"1000", "2000", "5000"}
    for bodies in result["rates"].values():
        assert set(bodies) == {"tick", "empty"}
        for loop in bodies.values():
            assert loop["periods"] == 16 and loop["missed"] >= 0
            assert set(loop["wake_up_us"]) == SPREAD and sane(loop["compute_us"])
        assert bodies["empty"]["compute_us"]["p50"] < bodies["tick"]["compute_us"]["p50"]


def test_simulation_program(tmp_path: Path) -> None:
    result, _ = run_program("simulation", 30, tmp_path)
    assert result["simulated_s"] == pytest.approx(0.03) and result["ticks"] == 30
    assert result["real_time_factor"] == pytest.approx(0.03 / result["wall_s"])
    assert sum(result["shares"].values()) == pytest.approx(1.0)
    assert min(result["us_per_tick"].values()) > 0.0
    assert {"MuJoCo: mj_step", "tick", "references", "the loop itself"} <= set(result["shares"])


@pytest.mark.parametrize("module", [peers, scaling, jitter, simulation])
def test_benchmarks_refuse_no_ticks(module) -> None:
    with pytest.raises(InvalidInputError, match=r"0 .* tell no time"):
        module.measure(0)


@pytest.mark.parametrize("name", CASES)
def test_textbook_law_gives_our_torques(name: str) -> None:
    """Without force integral: what the textbook's Ω_f(Λ_o) leaves out changes no torque then."""
    case = CASES[name]()
    forces = replace(case.gains.force, integral=0.0)
    case = replace(case, gains=replace(case.gains, force=forces))
    rng = np.random.default_rng(50)
    for _ in range(5):  # loops stay closed: only what is wanted varies
        reference = replace(
            case.reference,
            A_D=rng.normal(size=6),
            V_D=0.1 * rng.normal(size=6),
            alpha_d=rng.uniform(5.0, 20.0, len(case.pairs)),
            squeeze_d=rng.uniform(0.0, 20.0),
        )
        asked = replace(case, reference=reference)
        ours = asked.controller(compiled=False).tick(case.measurement, reference)
        np.testing.assert_allclose(TextbookLaw(asked).tick(), ours, atol=1e-8)


@pytest.mark.parametrize("name", ["two_contact_rod", "one_panda"])
def test_mujoco_inverse_explains_the_torques_on_every_contact(name: str) -> None:
    import mujoco

    case = CASES[name]()
    model, data = mujoco_state(case)
    assert data.ncon >= len(case.pairs)
    mujoco.mj_inverse(model, data)
    dofs = [int(model.joint(joint).dofadr[0]) for joint in case.chain.joint_names]
    wanted = np.zeros(case.chain.nq)
    wanted[case.chain.actuated] = data.ctrl
    np.testing.assert_allclose(data.qfrc_inverse[dofs], wanted, atol=1e-4)


@pytest.mark.parametrize("name", CASES)
def test_constraint_dynamics_moves_the_joints_as_commanded(name: str) -> None:
    case = replace(CASES[name](), pairs=())  # Pinocchio's contacts do not slide, ours do
    case = replace(case, reference=replace(case.reference, alpha_d=np.zeros(0)))
    controller = case.controller()
    controller.tick(case.measurement, case.reference)
    commanded = controller.joint_acceleration()
    found = np.array(constraint_dynamics(case)())
    arms = case.chain.state(case.measurement.q, case.measurement.v).arms
    for s, arm in zip(case.chain.slices, arms, strict=True):  # what posture moves is ours alone
        np.testing.assert_allclose(arm.J @ found[s], arm.J @ commanded[s], atol=1e-6)


@pytest.mark.parametrize("kind", KINDS)
def test_random_arms_hold_the_object(kind: str) -> None:
    rng = np.random.default_rng(51)
    rig = random_rig([kind] * 3, rng)
    state = rig.chain.state(rig.q, np.zeros(rig.chain.nq))
    assert state.d == KINDS[kind]
    for X in rig.chain.object_poses():
        np.testing.assert_allclose(X.homogeneous, rig.X_WO.homogeneous, atol=1e-12)
    pairs = faces_of(rig, 9, 3, rng)
    assert len(pairs) == 9 and contact_of(rig, pairs).r == 3
    with pytest.raises(InvalidInputError, match="cannot have r = 7"):
        faces_of(rig, 9, 7, rng)
    with pytest.raises(InvalidInputError, match="no arm 'delta'"):
        random_rig(["delta"], rng)


def interpreter(path: Path, script: str) -> Path:
    path.write_text(f"#!/bin/sh\n{script}\n")
    path.chmod(0o755)
    return path


def test_tsid_runs_in_its_own_interpreter(tmp_path: Path) -> None:
    times = {"p50": 9.3, "p99": 10.0, "p99_9": 11.0, "max": 12.0}
    said = {"pin": "3.4.0", "total_us": times, "problem_us": times, "solve_us": times,
            "floor_us": times}  # fmt: skip
    python = interpreter(tmp_path / "python", f"echo '{json.dumps(said)}'")
    report = run_benchmark("peers", 1, tsid_python=python)
    panda = report.data["cases"]["one_panda"]
    assert panda["peers_us"][peers.TSID] == times
    tsid = report.data["tsid"]
    assert tsid["ratio"] == pytest.approx(9.3 / tsid["tick_us"]["p50"])
    assert "TSID / tick" in str(report.tables[-1].caption)
    broken = interpreter(tmp_path / "broken", "echo 'no module tsid' >&2; exit 1")
    with pytest.raises(InvalidInputError, match=r"no module tsid.*pip install"):
        run_benchmark("peers", 1, tsid_python=broken)
    with pytest.raises(InvalidInputError, match=r"cannot be run.*pip install"):
        run_benchmark("peers", 1, tsid_python=tmp_path / "nowhere")
    with pytest.raises(InvalidInputError, match="only the benchmark 'peers'"):
        run_benchmark("jitter", 1, tsid_python=python)


def test_calls_take_turns() -> None:
    order = []
    calls = {"a": lambda: order.append("a"), "b": lambda: (order.append("b"), sleep(2e-3))}
    found = take_turns(calls, 4, between=lambda: order.append("|"))
    assert "".join(order) == "ab|" * (len(order) // 3)
    assert found["a"].shape == found["b"].shape == (4,)
    assert found["b"].min() >= 2000.0 > np.median(found["a"])


def test_deadlines_are_absolute_and_missed_ones_counted() -> None:
    start = perf_counter()
    late, spent, missed = jitter.clocked(lambda: None, 1000, 300)
    took = perf_counter() - start
    assert late.min() >= 0.0 and spent.shape == (300,)
    assert 0.3 <= took < 1e-3 * (300 + missed) + 1e-6 * late[-1] + 0.012, "deadlines drift"
    late, spent, missed = jitter.clocked(lambda: sleep(2.5e-3), 1000, 10)
    assert missed >= 20 and spent.min() >= 2500.0
    assert np.median(late) < 2000.0, "a missed deadline is made up for"


def test_ledger_counts_inner_calls_once_and_puts_everything_back(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now = [0.0]  # a clock that only the calls move on
    monkeypatch.setattr(simulation, "perf_counter", lambda: now[0])

    class Plant:
        def step(self) -> None:
            now[0] += 2.0
            self.solve()

        def solve(self) -> None:
            now[0] += 5.0
            raise ValueError

    ledger, before = simulation.Ledger(), Plant.step
    calls = [("step", Plant, "step"), ("solve", Plant, "solve")]
    with pytest.raises(ValueError), ledger.watching(calls):
        Plant().step()
    assert Plant.step is before
    assert ledger.spent == {"step": 2.0, "solve": 5.0}
