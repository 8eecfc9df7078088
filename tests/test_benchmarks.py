"""The benchmarks run as programs, write what they print, and time what they say they time."""

import json
import re
import sys
from dataclasses import replace
from time import process_time, sleep

import numpy as np
import pinocchio as pin
from command_line import read_json
from complaints import invalid_input
from numpy.testing import assert_array_equal
from processes import python
from pytest import approx, mark
from rigs import assert_near, largest, ticked
from samples import ROOT, aligned, first, parametrize

import osc_contact as osc
from benchmarks import false_stops, many_runs, peers, stack
from benchmarks.__main__ import BENCHMARKS, run_benchmark
from benchmarks.cases import CASES, KINDS, SPECIAL_CASES, BatchCase, OwnFace
from benchmarks.false_stops import try_errors
from benchmarks.kept import Kept
from benchmarks.measuring import take_turns
from benchmarks.peers import constraint_dynamics, mujoco_state
from benchmarks.textbook import TextbookLaw
from benchmarks.tick import ALL_CASES
from osc_contact.control.status import Phase
from osc_contact.lab.sweeps.workers import available_cores

GROWS = """import mmap
from benchmarks.soak import resident
pages, before = mmap.mmap(-1, 32 << 20), resident()
for at in range(0, len(pages), mmap.PAGESIZE):
    pages[at] = 1
print(resident() - before)"""  # in a process of its own: others free memory meanwhile
SPREAD = {"p50", "p99", "p99_9", "max"}


def start(line, code=0):
    return python("-W", "error", "-m", "benchmarks", *line.split(), code=code, cwd=ROOT)


@parametrize("line, words", {"nope": "no benchmark", "tick --ticks many": "valid integer"})
def test_benchmark_refuses_bad_input(line, words, tmp_path):
    file = tmp_path / "b.json"
    done = start(f"{line} --json {file}", 2)
    assert words in done.stderr and not done.stdout and not file.exists()


def judge_peers(result):
    for name in ("two_contact_rod", "one_panda"):
        rows = {row["peer"]: row for row in result[name]}
        assert len(rows) == 5
        for row in rows.values():
            assert row["ratio"] == approx(row["p50"] / rows["tick"]["p50"])
    assert "pip install" in result["tsid"]


def judge_scaling(result):
    sizes = [(row["kind"], row["arms"]) for row in result["arms"]]
    assert sizes == [(k, n) for k in (*KINDS, "mixed") for n in range(1, 9)]
    assert [row["r"] for row in result["ranks"]] == list(range(7))
    for row in (*result["arms"], *result["ranks"], *result["contacts"]):
        assert row["tick / arm (µs)"] == approx(row["tick p50 (µs)"] / row["arms"])
    assert [row["known"] for row in result["known"]] == [2, 4, 8, 12]
    assert result["known"][0]["of two"] == 1.0


def judge_vector_env(result):
    for rates in result["rates"]:
        assert 0.0 < rates["control, of the clock"] < 1.0 < rates["control ticks / s"]


def judge_tick(result):
    rows = {row["case"]: row for row in result["tick"]}
    assert set(rows) == set(ALL_CASES)
    for name, row in rows.items():
        assert row["tick / floor"] == approx(row["tick p50 (µs)"] / row["floor p50 (µs)"])
        assert (row["law p50 (µs)"] is not None) == (name in CASES)


PROGRAMS = (judge_peers, judge_tick, judge_scaling, judge_vector_env)


@parametrize("judge", first(PROGRAMS, 1))
def test_programs_write_what_they_measure(judge, tmp_path):
    file = tmp_path / "b.json"
    printed = start(f"{judge.__name__.removeprefix('judge_')} --ticks 16 --json {file}").stdout
    result = read_json(file)
    judge(result)
    about = result["machine"]
    assert about["cpu"] in printed and f"pin {about['pin']}" in printed
    assert about["cores"] >= 1 and about["python"] == sys.version.split()[0]
    assert about["osc-contact"] == osc.__version__
    for name, rows in result.items():
        assert name in printed or name == "machine"
        for row in rows if isinstance(rows, list) else ():
            if set(row) >= SPREAD:
                assert row["p50"] <= row["p99"] <= row["p99_9"] <= row["max"]


def test_a_late_wrist_is_compared_with_whole_weights_from_the_first_tick():
    """The mean of two ticks began with half of the first weight: a stop at 0.125 s."""
    some = false_stops.Errors("limited_rod", 0.02, 0, True)
    assert try_errors(some, duration=0.2) == false_stops.Ended(some)


def test_false_stops_finds_a_stop_and_keeps_it(monkeypatch, tmp_path):
    """Wrists that lose a fifth of their readings are too much for a limit of 1 %."""
    some = false_stops.Errors("two_contact_rod", 0.01, 16, True)
    assert some in false_stops.runs()
    assert try_errors(some, duration=0.05) == false_stops.Ended(some)
    lost = "sensors.wrist={rate: 1 kHz, dropout: 0.5}"
    changes = [lost, "control.safety.wrench_timeout=1 ms", "control.safety.missed_share=0.01"]
    monkeypatch.setattr(false_stops.Errors, "overrides", lambda self: changes)
    ended = try_errors(some, duration=0.3)
    assert ended.stopped and ended.reason
    kept = Kept(tmp_path, false_stops.read_ended)
    kept.add(ended)
    assert Kept(tmp_path, false_stops.read_ended).found == {some: ended}


def test_friction_and_noise_do_not_stop_the_step_of_limited_rod():
    """On the way back from 5 cm its tips move at 0.52 m/s, above the default ceiling."""
    errors = false_stops.Errors("limited_rod", 0.02, 20, True)
    assert try_errors(errors, duration=6.3) == false_stops.Ended(errors)


@mark.slow
def test_many_runs_program(monkeypatch):
    monkeypatch.setattr(many_runs, "DURATION", 1.05)
    start = process_time()
    found = many_runs.measure(2)
    both = found["row_s"] + found["row_s of the same robot"]
    assert 0.0 < found["row_s of the same robot"] < both < (process_time() - start) / 2
    (extrapolated,) = (value for name, value in found.items() if "1000 rows" in name)
    assert extrapolated == approx(1000 * found["row_s"] / available_cores())


@parametrize("name", BENCHMARKS)
def test_benchmarks_refuse_no_ticks(name):
    with invalid_input(r"0 .* give no time"):
        run_benchmark(name, 0)


@parametrize("name", [*CASES, *SPECIAL_CASES])
def test_every_timed_tick_is_checked_and_begins_alike(name):
    """Integrals are zero at every timed tick; one that ends in another way is not timed."""
    case = (CASES | SPECIAL_CASES)[name]()
    controller = case.controller()
    tick, unwind = case.tick(controller)
    first = tick()
    assert controller.status is case.status, controller.reason
    for _ in range(3):
        unwind()
        assert not controller.motion_integral.any() and not len(controller.force_integral)
    assert_near(tick(), first, atol=1e-12 * largest(first), rtol=0)
    another = next(status for status in osc.Status if status is not case.status)
    tick, unwind = replace(case, status=another).tick()
    tick()
    with invalid_input(f"ended {case.status.name}.*expected {another.name}"):
        unwind()


def test_special_cases_are_what_they_are_called():
    found = {name: make() for name, make in SPECIAL_CASES.items()}
    unusual = {name: case.status.name for name, case in found.items() if case.status.value}
    assert unusual == {"near_singular": "DEGRADED", "saturated": "SATURATED"}
    last = {}
    for name, case in found.items():
        last[name] = case.controller()
        last[name].tick(*case.given)
    assert [0.0 < one.left < 1.0 for one in last["near_singular"].lost_directions] == [True, True]
    assert last["saturated"].given_up is not None
    bars = found["three_arms"].reference.squeeze_d
    assert_near(last["three_arms"].result().squeeze, bars, atol=1e-6)
    assert_array_equal(last["contact_phases"].phases(), Phase.CLOSED)
    assert [type(pair) for pair in last["own_pair"].contacts] == [OwnFace, osc.VertexOnFace]


@parametrize("threads", [1, 2])
def test_a_timed_batch_is_its_single_ticks_and_every_row_is_checked(threads):
    rows = BatchCase(CASES["one_panda"](), 5, threads)
    tick, unwind = rows.tick()
    for _ in range(2):  # from the same memory each time
        torques = tick()
        unwind()
        case = rows.case
        for i in range(rows.rows):

            def of_row(given, *names, i=i):
                return replace(given, **{name: rows.inputs[name][i] for name in names})

            desired = of_row(case.reference, "V_D", "A_D", "alpha_d")
            read = of_row(case.measurement, "q", "v", "wrenches")
            assert_array_equal(torques[i], case.controller().tick(read, desired))
    assert len(np.unique(torques[:, 0])) == rows.rows, "every row is at a state of its own"
    rows.inputs["q"][3, 0] = np.nan
    tick()
    with invalid_input("ended HELD in 1 rows, the first of them 3"):
        unwind()


@parametrize("name", [*CASES, "own_pair"])
def test_textbook_law_gives_our_torques(name):
    """Without force integral: what the textbook's Ω_f(Λ_o) leaves out changes no torque then."""
    case = (CASES | SPECIAL_CASES)[name]()
    gains = case.gains.replaced(
        force=case.gains.force.replaced(integral=0.0, rise=0.0),
        motion=case.gains.motion.replaced(integral=2000.0),
    )
    rng = np.random.default_rng(50)
    for _ in range(5):  # what is wanted varies
        reference = replace(
            case.reference,
            X_WD=case.reference.X_WD * pin.exp6(0.001 * rng.standard_normal(6)),
            A_D=rng.standard_normal(6),
            V_D=0.1 * rng.standard_normal(6),
            alpha_d=rng.uniform(5.0, 20.0, len(case.pairs)),
            squeeze_d=rng.uniform(0.0, 20.0),
        )
        varied = replace(case, gains=gains, reference=reference)
        controller = varied.controller()
        textbook = TextbookLaw(varied)
        for _ in range(4):  # the motion integral grows
            ours = ticked(controller, case.measurement, reference)
            assert_near(textbook.tick(), ours, atol=1e-8, rtol=0)
        integral = controller.motion_integral
        assert largest(integral) > 1e-6
        assert_near(textbook.motion_sum, integral, atol=1e-12, rtol=0)


@parametrize("name", ["two_contact_rod", "one_panda"])
def test_mujoco_inverse_explains_the_torques_on_every_contact(name):
    import mujoco

    case = CASES[name]()
    model, data = mujoco_state(case)
    assert data.ncon >= len(case.pairs)
    mujoco.mj_inverse(model, data)
    dofs = [int(model.joint(joint).dofadr[0]) for joint in case.chain.joint_names]
    expected = np.zeros(case.chain.nq)
    expected[case.chain.actuated] = data.ctrl
    assert_near(data.qfrc_inverse[dofs], expected, atol=1e-4)


@parametrize("name", [*CASES, "three_arms"])
def test_constraint_dynamics_moves_the_joints_as_commanded(name):
    case = (CASES | SPECIAL_CASES)[name]()
    reference = replace(case.reference, alpha_d=np.zeros(0))
    case = replace(case, pairs=(), reference=reference)  # Pinocchio's contacts do not slide
    # friction is compensated along the speed that is commanded, not along the one read here
    case.chain.model.damping = np.zeros(case.chain.nq)
    controller = case.controller()
    controller.tick(*case.given)
    commanded = controller.joint_acceleration()
    found = np.array(constraint_dynamics(case)())
    arms = case.chain.state(case.measurement.q, case.measurement.v).arms
    for s, arm in aligned(case.chain.slices, arms):  # what posture moves is ours alone
        assert_near(arm.J @ found[s], arm.J @ commanded[s], atol=1e-6)


def interpreter(path, script):
    path.write_text(f"#!/bin/sh\n{script}\n")
    path.chmod(0o755)
    return path


def test_tsid_runs_in_its_own_interpreter(tmp_path):
    found = {peers.TOTAL: [8.0, 9.3, 12.0], "solve": [3.0]}
    python = interpreter(tmp_path / "python", f"echo '{json.dumps(found)}'")
    tsid = {row["part"]: row for row in run_benchmark("peers", 1, tsid_python=python)["tsid"]}
    assert tsid[peers.TOTAL]["p50"] == 9.3 and tsid[peers.TOTAL]["max"] == 12.0
    assert tsid["TSID / tick"]["p50"] == approx(9.3 / tsid["the tick"]["p50"])
    broken = interpreter(tmp_path / "broken", "echo 'no module tsid' >&2; exit 1")
    for name, other, words in (
        ("peers", broken, r"no module tsid.*pip install"),
        ("peers", tmp_path / "nowhere", r"cannot be run.*pip install"),
        ("tick", python, "only the benchmark 'peers'"),
    ):
        with invalid_input(words):
            run_benchmark(name, 1, tsid_python=other)


@mark.slow
def test_a_soak_reports_memory_that_grows_and_runs_that_differ():
    first, second = run_benchmark("soak", 300)["runs"]
    assert first["hash"] == second["hash"] and first["ticks"] == 300
    assert 0.0 <= first["grown_MB"] < 5.0 < first["begin_MB"] <= first["peak_MB"]
    assert 30.0 < float(python("-c", GROWS, cwd=ROOT).stdout) < 40.0


def test_calls_take_turns():
    order = []
    calls = {"a": lambda: order.append("a"), "b": lambda: (order.append("b"), sleep(2e-3))}
    found = take_turns(calls, 4, between=lambda: order.append("|"))
    assert "".join(order) == "ab|" * (len(order) // 3)
    assert found["a"].shape == found["b"].shape == (4,)
    assert found["b"].min() >= 2000.0 > np.median(found["a"])


def test_stack_of_a_tick_is_what_the_manual_states(tmp_path):
    """Arms of ten joints and of seven; a pattern finds the deepest byte that a tick overwrites."""
    call = stack.harness(tmp_path)
    text = (ROOT / "docs/without_python.md").read_text()
    stated = 1000 * int(re.search(r"needs (\d+) kB of stack", text)[1])
    for name in ("two_contact_rod", "one_panda"):
        assert 0.5 * stated < stack.stack_of(CASES[name](), call) <= stated
