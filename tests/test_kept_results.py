"""What runs and sweeps leave in files: one writer at a time, damage named, nobody left behind."""

import json
import os
import shutil
import signal
import subprocess
import sys
import zipfile
from contextlib import suppress
from pathlib import Path

import numpy as np
from command_line import done, refused
from complaints import invalid_input, recording_error
from numpy.testing import assert_array_equal
from processes import alive, wait_until
from pytest import mark

import osc_contact as osc
from osc_contact import robots
from osc_contact.files import sole_user
from osc_contact.recorder.journal import Journal, JournalFile
from osc_contact.sweeps.rows import RowFile
from osc_contact.sweeps.study import SweepStudy

COMMAND = [sys.executable, "-c", "from osc_contact.cli import app; app()"]


def test_a_second_run_in_a_folder_is_refused_and_the_first_keeps_its_rows(tmp_path):
    words = ["run", "two_contact_rod", "--duration", "1000", "--out", tmp_path]
    how = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
    with subprocess.Popen([*COMMAND, *words], **how) as process:
        try:
            rows = tmp_path / "unfinished.mcap"
            wait_until(rows.exists, process=process)
            number = rows.stat().st_ino
            said = refused("run two_contact_rod --duration 1.2 --out", tmp_path)
            assert process.poll() is None and rows.stat().st_ino == number
        finally:
            process.kill()
    assert "another program writes to" in said and "--out" in said, said
    with sole_user(tmp_path):  # the lock ends with its process
        assert rows.exists()


def rows_of(first, count):
    rows = np.zeros(count, [("x", "<f8", (2,))])
    rows["x"] = np.arange(first, first + count)[:, None]
    return rows


def test_rows_of_chunks_that_come_again_are_read_once(tmp_path):
    path = tmp_path / "unfinished.mcap"
    file = JournalFile(path, {"name": "x"})
    for first, count in ((0, 5), (0, 5), (5, 3), (3, 7), (10, 1), (10, 1)):
        file.append(first, rows_of(first, count))
    file.close()
    journal = Journal(path)
    firsts, pieces = zip(*journal.rows(), strict=True)
    assert_array_equal(np.concatenate(pieces)["x"][:, 0], np.arange(11))
    assert firsts == (0, 5, 8, 10)
    assert journal.missing == [
        f"ticks {part} come again, and are left out there"
        for part in ("0 to 4", "3 to 7", "10 to 10")
    ]
    whole = JournalFile(tmp_path / "whole.mcap", {})
    for first in (0, 5):
        whole.append(first, rows_of(first, 5))
    whole.close()
    reader = Journal(tmp_path / "whole.mcap")
    assert [first for first, _ in reader.rows()] == [0, 5] and not reader.missing


def study_of(samples=4):
    return SweepStudy.of("two_contact_rod", ["seed=integers(0, 9)"], samples)


def row_of(number):
    return {"row": number, "seed": number, "word": "HELD", "failed": False, "why": "", "x": 0.5}


def write(path, study, *rows):
    file = RowFile(path, study)
    file.append(rows)
    file.close()
    return file


DAMAGE = {
    "cut": lambda line: line[: len(line) // 2],
    "binary": lambda line: b"\x00\xff\xfe" + line[3:],
    "text": lambda line: b"<html>",
    "list": lambda line: b"[1, 2]",
    "number": lambda line: b"7",
    "no_row": lambda line: line.replace(b'"row"', b'"raw"').replace(b'"study"', b'"steady"'),
    "row_of_another_kind": lambda line: line.replace(b'"row": 1', b'"row": "1"').replace(
        b'"study": "', b'"study": 1, "x": "'
    ),
    "deep": lambda line: b"[" * 100_000,
}


@mark.parametrize("at", [1, 3])
@mark.parametrize("kind", DAMAGE)
def test_damaged_rows_are_named_with_the_line_and_a_cure(kind, at, tmp_path):
    path = tmp_path / "rows.jsonl"
    study = study_of()
    write(path, study, *map(row_of, range(3)))
    lines = path.read_bytes().splitlines()
    lines[at - 1] = DAMAGE[kind](lines[at - 1])
    path.write_bytes(b"\n".join(lines) + b"\n")
    damaged = path.read_bytes()
    with invalid_input(rf"rows\.jsonl: line {at} is damaged \(.+\); rem"):
        RowFile(path, study)
    assert path.read_bytes() == damaged
    del lines[at - 1]
    path.write_bytes(b"".join(line + b"\n" for line in lines) if at > 1 else b"")  # the cure
    assert sorted(write(path, study).done) == ([0, 2] if at > 1 else [])


def test_rows_beyond_a_study_and_cells_of_another_kind(tmp_path):
    study = study_of(3)
    path = tmp_path / "rows.jsonl"
    write(path, study, *map(row_of, (0, 1, 2, -1, 17)))
    table = osc.sweep("two_contact_rod", study.vary, 3, out=tmp_path, workers=1)
    assert table["row"].to_pylist() == [0, 1, 2]
    write(path, study, row_of(1) | {"x": "half"})
    with invalid_input(r"'x' are of several kinds .* are damaged"):
        osc.sweep("two_contact_rod", study.vary, 3, out=tmp_path, workers=1)


def test_two_programs_do_not_write_rows_to_one_file(tmp_path):
    path = tmp_path / "rows.jsonl"
    study = study_of()
    file = RowFile(path, study)
    with invalid_input(r"another program writes to .*rows\.jsonl"):
        RowFile(path, study)
    file.append([row_of(0)])
    file.close()
    other = SweepStudy.of("two_contact_rod", ["seed=integers(0, 99)"], 4)
    for _ in range(2):  # a refusal holds nothing
        with invalid_input("another study") as refused:
            RowFile(path, other)
    assert refused and write(path, study).done == {0: row_of(0)}


def test_metrics_of_a_recording_without_meta_name_what_is_missing():
    channels = {"t": np.arange(2000) * 1e-3, "alpha_true": np.zeros((2000, 2))}
    recording = osc.Recording({}, channels)
    with recording_error("meta has no 'contact_names', but nothing"):
        osc.metrics(recording)
    recording.meta["contact_names"] = ["left", "right"]
    with recording_error(r"has no 'control_rate_hz', but contact_names;"):
        osc.metrics(recording)
    assert recording.meta.get("plant") is None and json.dumps(recording.meta)


SWEEP = """
import sys
import osc_contact as osc

if __name__ == "__main__":
    osc.sweep("two_contact_rod", ["seed=integers(0, 9)"], 5000, workers=2, out=sys.argv[1],
              overrides=["duration=1.2"])
"""


def children_of(number):
    """Processes below another one."""
    found = []
    with suppress(FileNotFoundError):
        for task in Path(f"/proc/{number}/task").iterdir():
            own = [int(word) for word in (task / "children").read_text().split()]
            found += own + [below for one in own for below in children_of(one)]
    return found


@mark.skipif(not Path("/proc/self/task").exists(), reason="children are found in /proc")
def test_workers_end_with_a_sweep_that_is_killed(tmp_path):
    (tmp_path / "sweep.py").write_text(SWEEP)
    command = [sys.executable, tmp_path / "sweep.py", tmp_path / "out"]
    package = {"PYTHONPATH": str(Path(osc.__file__).parents[1])}
    process = subprocess.Popen(command, env=os.environ | package)
    rows = tmp_path / "out" / "rows.jsonl"
    workers = []
    try:
        wait_until(lambda: rows.exists() and rows.read_bytes().count(b"\n") > 2, process=process)
        workers = children_of(process.pid)
        assert len(workers) >= 2
        process.kill()
        process.wait()
        wait_until(lambda: not any(map(alive, workers)), 2.0)  # none outlives its sweep
    finally:
        process.kill()
        process.wait()
        for worker in filter(alive, workers):
            os.kill(worker, signal.SIGKILL)


def test_recordings_hold_no_folder_and_are_shown_with_the_scenarios(tmp_path, monkeypatch):
    home = tmp_path / "home" / "somebody"
    shown = tmp_path / "elsewhere"
    home.mkdir(parents=True)
    shown.mkdir()
    packaged = osc.load_scenario("two_contact_rod")
    text = Path(str(packaged.source)).read_text()
    assert packaged.object.urdf in text
    shutil.copy(robots.urdf_path("rod"), home / "my_rod.urdf")
    (home / "mine.yaml").write_text(text.replace(packaged.object.urdf, "my_rod.urdf"))
    scenario = osc.load_scenario(home / "mine.yaml")
    recording = osc.run(scenario, duration=0.05, journal=shown / "unfinished.mcap")
    path = recording.save(shown / "run.npz")
    for file in (path, shown / "run.times.npz"):
        with zipfile.ZipFile(file) as archive:
            assert not any(b"somebody" in archive.read(name) for name in archive.namelist())
    assert b"somebody" not in (shown / "unfinished.mcap").read_bytes()
    monkeypatch.chdir(tmp_path)
    page = tmp_path / "page.html"
    for name in ("run.npz", "unfinished.mcap"):
        said = refused("view", shown / name, "--html", page)
        assert "copy them beside the recording" in said and "--folder" in said, said
        done("view", shown / name, "--html", page, "--folder", home)
    assert len(osc.recover(shown / "unfinished.mcap", home)) == 50
    shutil.copy(home / "my_rod.urdf", shown)
    done("view", path, "--html", page)
