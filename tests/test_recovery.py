"""Recovery of runs that were killed, interrupted, or ran out of disk space or shared a file."""

import csv
import json
import os
import resource
import signal
import sys
from pathlib import Path
from time import sleep

from complaints import recording_error
from mcap.reader import make_reader
from numpy.testing import assert_array_equal
from processes import COMMAND, python, started
from pytest import approx, mark, raises
from samples import first, module_fixture, parametrize
from scenario_runs import run_of

import osc_contact as osc
from osc_contact.lab.rig import rig
from osc_contact.lab.scenarios.hardware import PLANT_TYPES
from osc_contact.loop import recorder as rows_of_runs

RUN = [sys.executable, str(Path(__file__).with_name("recorded_run.py"))]
pytestmark = mark.usefixtures("usual_handlers")


def same(found, whole):
    """All channels of the ticks of both."""
    cut = min(len(found), len(whole))
    for name in set(whole.channels) - {"tick_s"}:
        assert_array_equal(found[name][:cut], whole[name][:cut], err_msg=name)


@module_fixture
def whole():
    return run_of("two_contact_rod", duration=1.2, seed=3)


@parametrize("seconds", first([0.17, 0.13, 0.22], 1))
def test_a_killed_run_is_recovered_but_for_its_last_moments(seconds, tmp_path, whole):
    with started([*RUN, tmp_path, "200"]) as process:
        process.stdout.readline()
        sleep(seconds)
        process.kill()
        simulated = [0.1, *map(float, process.stdout.read().split())][-1]
    found = osc.recover(tmp_path / "unfinished.mcap")
    assert len(found) > 100
    same(found, whole)
    # 80 ms on the clock, and what this machine simulates in that time
    assert len(found) > 1000 * simulated - 3000
    short, count = found.meta["missing"]
    assert short.startswith("the run was cut short") and "of 200000 ticks are here" in count
    with recording_error(r"osc_contact\.recover"):
        osc.Recording.load(tmp_path / "unfinished.mcap")


def test_ctrl_c_ends_a_run_in_order(tmp_path, whole):
    words = ["run", "two_contact_rod", "--duration", "200", "--seed", "3", "--out", tmp_path]
    with started([*COMMAND, *words]) as process:
        journal = tmp_path / "unfinished.mcap"
        while not journal.exists() or journal.stat().st_size < 20_000:  # until there are ticks
            sleep(0.05)
        process.send_signal(signal.SIGINT)
        printed, complaints = process.communicate(timeout=300)
    assert process.returncode == 130
    assert all("compil" in line for line in complaints.split("\n") if line), complaints
    assert "ended on request at t = " in printed and f"written to {tmp_path}: " in printed
    assert not (tmp_path / "unfinished.mcap").exists()
    found = osc.Recording.load(tmp_path / "recording.npz")
    assert found.meta["ended_s"] == approx(len(found) * 1e-3)
    same(found, whole)
    judged = len(found) > 1000
    assert (tmp_path / "metrics.json").exists() == (tmp_path / "scene.html").exists() == judged


@parametrize("plant", ["rigid", "mujoco"])  # in Python, compiled
@parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_run_ended_by_a_signal_gives_what_it_has(number, plant):
    before = signal.getsignal(number)

    def ask(t):
        os.kill(os.getpid(), number)

    scenario = osc.load_scenario("two_contact_rod", [f"plant.type={plant}", "plant.step=1 ms"])
    with raises(osc.Interrupted, match=r"ended on request at t = 0\.1 s") as ended:
        run_of(scenario, duration=0.5, progress=ask)
    assert isinstance(ended.value, KeyboardInterrupt) and len(ended.value.recording) == 100
    assert signal.getsignal(number) == before


def test_a_run_goes_on_when_the_disk_is_full(tmp_path, whole):
    def small():
        resource.setrlimit(resource.RLIMIT_FSIZE, (1_000_000, 1_000_000))

    with started([*RUN, tmp_path, "1.2"], preexec_fn=small) as process:
        printed, complaints = process.communicate(timeout=300)
    *loop, last = printed.splitlines()
    assert loop[-1] == "1.2", "the loop went on"
    assert complaints.startswith("recording stops after") and "File too large" in complaints
    assert complaints.endswith("; the loop continues\n") and complaints.count("\n") == 1
    found = osc.recover(tmp_path / "unfinished.mcap")
    assert 200 < len(found) < 1000
    same(found, whole)
    assert last.startswith(f"{len(found)} recording stops after {len(found)} ticks")
    assert len(osc.Recording.load(tmp_path / "recording.npz")) == len(found)


def test_two_runs_of_a_seed_are_the_same_file(tmp_path):
    files = []
    for kind, seed, threads in (("a", "1", "1"), ("b", "77", "2")):
        (tmp_path / kind).mkdir()
        setting = {"PYTHONHASHSEED": seed, "OPENBLAS_NUM_THREADS": threads}
        setting |= {"NUMBA_NUM_THREADS": threads, "OMP_NUM_THREADS": threads}
        assert python(*RUN[1:], tmp_path / kind, "0.7", **setting).stdout.split()[-1] == "700"
        files.append((tmp_path / kind / "recording.npz").read_bytes())
    assert files[0] == files[1]


@parametrize(
    "name, plant",
    {
        "two_contact_rod": "rigid",
        "moving_face": "mujoco",
        "two_contact_rod_mismatch": "mujoco",
        "three_arm_plate": "mujoco",
    },
)
def test_chunks_of_any_size_make_the_same_recording(name, plant, monkeypatch, tmp_path):
    scenario = osc.load_scenario(name, [f"plant.type={plant}"])
    once = run_of(scenario, duration=0.06)
    monkeypatch.setattr(rows_of_runs, "_WRITE_EVERY_S", 0.0)
    monkeypatch.setattr("osc_contact.recorder.archive.IN_MEMORY", 0)
    same(run_of(scenario, duration=0.06, journal=tmp_path / "unfinished.mcap"), once)
    recovered = osc.recover(tmp_path / "unfinished.mcap")
    assert recovered.meta["missing"] == []
    same(recovered, once)


@mark.slow
def test_memory_does_not_grow_with_the_run():
    code = (
        "import resource, osc_contact as osc\n"
        "peak = lambda: resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024\n"
        "scenario = osc.load_scenario('two_contact_rod')\n"
        "osc.run(scenario, duration=20.0)\n"
        "before = peak()\n"
        "osc.metrics(osc.run(scenario, duration=80.0))\n"
        "print(before, peak() - before)\n"
    )
    whole, more = map(float, python("-c", code).stdout.split())
    assert more < 40.0, f"{more:.0f} MB beside {whole:.0f} MB"  # 75 MB of rows and channels


def test_exports_say_the_same(tmp_path, whole):
    with open(whole.export(tmp_path / "run.csv"), encoding="ascii") as file:
        head, *lines = csv.reader(file)
    assert len(lines) == len(whole) and head[:3] == ["t", "q.0", "q.1"]
    column = head.index("N.1.0")
    assert [float(line[column]) for line in lines] == whole["N"][:, 1, 0].tolist()
    with open(whole.export(tmp_path / "run.mcap"), "rb") as file:
        reader = make_reader(file, validate_crcs=True)
        messages = [(m.log_time, json.loads(m.data)) for _, _, m in reader.iter_messages()]
        (about,) = reader.iter_metadata()
    assert json.loads(about.metadata["meta"]) == whole.meta
    assert [at for at, _ in messages] == [round(t * 1e9) for t in whole["t"]]
    for name in ("tau", "closed", "status", "N"):
        assert messages[700][1][name] == whole[name][700].tolist()
    with recording_error(r"run\.hdf5: give a name that ends in"):
        whole.export(tmp_path / "run.hdf5")


@parametrize("plant", ["mujoco", "rigid"])
def test_a_journal_is_read_without_arms_controller_and_plant(plant, monkeypatch, tmp_path):
    scenario = osc.load_scenario("moving_face", [f"plant.type={plant}", "model_error={}"])
    whole = run_of(scenario, duration=0.06, journal=tmp_path / "unfinished.mcap")

    def no_more(*_, **__):
        raise AssertionError("this is made for runs only")

    for name in ("ClosedChain", "Controller", "MujocoPlant", "RigidPlant", "Arm"):
        monkeypatch.setattr(f"osc_contact.lab.rig.rig.{name}", no_more)
    recovered = osc.recover(tmp_path / "unfinished.mcap")
    assert recovered.meta["missing"] == []
    same(recovered, whole)


def test_a_plant_without_readable_notes_is_made_to_recover(monkeypatch, tmp_path):
    monkeypatch.setitem(rig.PLANTS, "halved", rig.PLANTS["rigid"])
    monkeypatch.setitem(PLANT_TYPES, "halved", True)
    scenario = osc.load_scenario("two_contact_rod", ["plant.type=halved", "plant.step=1 ms"])
    whole = run_of(scenario, duration=0.03, journal=tmp_path / "unfinished.mcap")
    same(osc.recover(tmp_path / "unfinished.mcap"), whole)
