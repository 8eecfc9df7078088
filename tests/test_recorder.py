"""Recordings, journals and rows of sweeps in files: exact, never half, damage named."""

import io
import json
import os
import random
import shutil
import signal
import zipfile

import numpy as np
from command_line import done, refused
from complaints import invalid_input, recording_error, refusals
from numpy.testing import assert_array_equal
from processes import COMMAND, started, wait_until
from pytest import raises
from samples import parametrize
from scenario_runs import run_of

import osc_contact as osc
from osc_contact import robots
from osc_contact.errors import RecordingError
from osc_contact.files import sole_user
from osc_contact.lab.sweeps.study import SweepStudy
from osc_contact.lab.sweeps.sweep import RowFile
from osc_contact.recorder import Recording
from osc_contact.recorder.journal import Journal, JournalFile

META = {"scenario": {"name": "rod"}, "plant": "rigid", "seed": 3, "arm_names": ("left", "right")}


def record(ticks=5):
    k = np.arange(ticks)
    return Recording(
        META,
        {
            "t": 0.001 * k,
            "q": np.arange(4.0) + k[:, None],
            "closed": np.column_stack((k >= 0, k > 2)),
            "status": k,
            "contact_point": np.full((ticks, 2, 3), 0.1) + k[:, None, None],
        },
    )


test_bad_input_is_refused = refusals(
    recording_error,
    {
        "JSON-able .* range float values": lambda: Recording({"a": np.nan}, {}),
        "JSON-able .* ndarray": lambda: Recording({"a": np.zeros(2)}, {}),
        "'meta' cannot name a channel": lambda: Recording({}, {"meta": np.ones(2)}),
        "'file' cannot name a channel": lambda: Recording({}, {"file": np.ones(2)}),
        "differ in their number": lambda: Recording({}, {"q": np.zeros(2), "t": np.zeros(3)}),
        "first axis": lambda: Recording({}, {"q": np.array(1.0)}),
        "dtype object": lambda: Recording({}, {"q": np.array([None])}),
        "no channel 'qq' in this recording; there are: t, q": lambda: record()["qq"],
    },
)


def assert_same(one, other):
    assert one.meta == other.meta and one.channels.keys() == other.channels.keys()
    for name, values in other.channels.items():
        assert one[name].dtype == values.dtype
        assert_array_equal(one[name], values)


@parametrize("ticks", [5, 0])
def test_round_trip(ticks, tmp_path):
    recording = record(ticks) if ticks else Recording(META, {})
    path = recording.save(tmp_path / "new" / "run.npz")
    loaded = Recording.load(path)
    assert recording.meta == json.loads(json.dumps(META)) and len(loaded) == ticks
    assert_same(loaded, recording)
    assert os.listdir(path.parent) == ["run.npz"]


def test_a_folder_that_is_a_file_is_refused(tmp_path):
    (tmp_path / "out").write_text("")
    with recording_error("cannot write the recording"):
        record().save(tmp_path / "out" / "run.npz")


def written(save, *given, **arrays):
    """Bytes that a function of NumPy writes."""
    stream = io.BytesIO()
    save(stream, *given, **arrays)
    return stream.getvalue()


def npz(about, **arrays):
    return written(np.savez, meta=np.array(about), **arrays)


@parametrize(
    "content",
    [
        b"",
        b"not a recording",
        written(np.save, np.zeros(3)),
        written(np.savez, q=np.zeros(3)),
        npz([0.0, 0.0]),
        npz("{}"),
        npz("[1]"),
        npz("{"),
        npz([{"a": 1}]),
        npz('{"format": 2, "meta": {}}', q=np.zeros(3)),
        npz('{"format": 1, "meta": {}}', q=np.zeros(3), t=np.zeros(2)),
        npz('{"format": 1, "meta": 5}'),
    ],
    ids=range(12),
)
def test_unknown_files_are_refused(tmp_path, content):
    path = tmp_path / "run.npz"
    path.write_bytes(content)
    with recording_error(r"run\.npz|ticks|meta"):
        Recording.load(path)


def test_missing_files_are_refused(tmp_path):
    for path in (tmp_path / "none.npz", tmp_path):
        with recording_error("there is no such file"):
            Recording.load(path)


@parametrize("in_memory", [0, 1000])
def test_damaged_files_never_give_other_data(in_memory, tmp_path, monkeypatch):
    monkeypatch.setattr("osc_contact.recorder.archive.IN_MEMORY", in_memory)
    recording = record(300)
    path = tmp_path / "run.npz"
    whole = recording.save(path).read_bytes()
    rng = random.Random(1)
    damaged = [whole[:size] for size in range(0, len(whole), 370)]
    for at in rng.choices(range(len(whole)), k=400):
        flipped = whole[at] ^ 1 << rng.randrange(8)
        damaged.append(whole[:at] + bytes([flipped]) + whole[at + 1 :])
    refused = 0
    for content in damaged:
        path.write_bytes(content)
        try:
            loaded = Recording.load(path)
        except RecordingError:
            refused += 1
        else:
            assert_same(loaded, recording)
    assert refused > len(damaged) - 50


def test_the_same_content_makes_the_same_bytes_with_times_apart(tmp_path):
    made = []
    for run in ("first", "second"):
        spent = {"wall_s": 1.0 + len(run), "cpu_s": 2.0}
        channels = {**record().channels, "tick_s": np.full(5, 1.0 + len(run)), "last": np.arange(5)}
        recording = Recording(META | spent, channels)
        path = recording.save(tmp_path / run / "run.npz")
        loaded = Recording.load(path)
        assert loaded.meta == recording.meta and list(loaded.channels) == list(channels)
        assert loaded["tick_s"][0] == 1.0 + len(run)
        assert sorted(os.listdir(path.parent)) == ["run.npz", "run.times.npz"]
        made.append(path)
    first, second = made
    assert first.read_bytes() == second.read_bytes()
    times = second.with_name("run.times.npz")
    os.replace(first.with_name("run.times.npz"), times)
    assert Recording.load(second)["tick_s"][0] == 1.0 + len("first")  # the same run, so they fit
    record(5).save(second)
    assert os.listdir(second.parent) == ["run.npz"]
    other = Recording({}, {"tick_s": np.ones(3)}).save(tmp_path / "x.npz")
    os.replace(other.with_name("x.times.npz"), times)
    assert "tick_s" not in Recording.load(second), "times of another run"
    first.with_name("run.times.npz").unlink(missing_ok=True)
    without = Recording.load(first)
    assert "tick_s" not in without and "wall_s" not in without.meta and "q" in without


def test_numpy_reads_the_file_and_what_it_packed_is_read(tmp_path):
    with np.load(record().save(tmp_path / "run.npz")) as stored:
        assert_array_equal(stored["q"], record()["q"])
        assert json.loads(str(stored["meta"]))["meta"]["seed"] == 3
    about = np.array(json.dumps({"format": 1, "meta": META}))
    q = np.asfortranarray(record()["q"])
    for save in (np.savez, np.savez_compressed):
        save(tmp_path / "run.npz", meta=about, q=q)
        assert_array_equal(Recording.load(tmp_path / "run.npz")["q"], q)


def test_large_recordings_stay_in_their_file(tmp_path, monkeypatch):
    whole = record(10000)
    path = whole.save(tmp_path / "run.npz")
    monkeypatch.setattr("osc_contact.recorder.archive.IN_MEMORY", 1000)
    loaded = Recording.load(path)
    assert len(loaded) == 10000 and loaded.meta == json.loads(json.dumps(META))
    path.unlink()  # whoever has it open goes on reading
    for name, values in whole.channels.items():
        assert loaded.channels.data[name].nbytes == values.nbytes
        assert_array_equal(loaded[name], values)
        assert_array_equal(loaded.rows(7, 9, name)[name], values[7:9])
        assert_array_equal(loaded.at(-1)[name], values[-1])
    monkeypatch.setattr("osc_contact.recorder.recording._TICKS_OF_DISK_PIECE", 3000)
    pieces = list(loaded.pieces("q", "t"))
    assert [len(piece["t"]) for piece in pieces] == [3000, 3000, 3000, 1000]
    assert_array_equal(np.concatenate([piece["q"] for piece in pieces]), loaded["q"])
    thin = loaded.thinned(4000)
    assert len(thin) == 3334 and loaded.thinned(10000) is loaded
    assert_array_equal(thin["q"], loaded["q"][::3])
    again = loaded.save(tmp_path / "again.npz").read_bytes()
    assert again == whole.save(tmp_path / "third.npz").read_bytes()


def test_an_archive_that_unpacks_to_gigabytes_is_refused_at_once(tmp_path):
    path = tmp_path / "bomb.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("q.npy", bytes(300 << 20))
    assert path.stat().st_size < 400_000
    with recording_error(r"unpack from 0\.3\d* MB to 314\.6 MB"):
        Recording.load(path)


def test_headers_that_promise_more_than_there_is_are_refused(tmp_path):
    content = npz('{"format": 1, "meta": {}}', q=np.zeros(300))
    path = tmp_path / "run.npz"
    path.write_bytes(content.replace(b"(300,)", b"(1e9,)").replace(b"(300,), ", b"(9**9,)"))
    with raises(RecordingError):
        Recording.load(path)
    with zipfile.ZipFile(path, "w") as archive:
        about = {"descr": "<f8", "fortran_order": False, "shape": (1 << 40,)}
        head = written(np.lib.format.write_array_header_1_0, about)
        archive.writestr("q.npy", head + bytes(80))
    with recording_error(r"80 bytes for shape \(1099511627776,\)"):
        Recording.load(path)


@parametrize("broken", ["os.replace", "os.fsync", "zipfile.ZipFile.open"])
@parametrize("error", [OSError("disk full"), KeyboardInterrupt("stopped")])
def test_a_failed_save_keeps_the_older_file_and_leaves_nothing_else(
    tmp_path, monkeypatch, broken, error
):
    path = record(2).save(tmp_path / "run.npz")

    def fail(*args, **kwargs):
        raise error

    with monkeypatch.context() as patch:
        patch.setattr(broken, fail)
        expected = RecordingError if isinstance(error, OSError) else KeyboardInterrupt
        with raises(expected, match=str(error)):
            record(4).save(path)
    assert len(Recording.load(path)) == 2 and os.listdir(tmp_path) == ["run.npz"]


# Journals: what was appended survives cuts and flipped bits; kills: see test_recovery.


CHUNK = 100
ROW = np.dtype([("tick", "<i8"), ("numbers", "<f8", (120,))])


def rows(first, k):
    """Rows that say what they ought to hold."""
    out = np.zeros(k, ROW)
    out["tick"] = np.arange(first, first + k)
    out["numbers"] = np.sin(out["tick"])[:, None] + np.arange(120)
    return out


def journal_of(path):
    journal = JournalFile(path, {"seed": 3})
    for first in range(0, 6 * CHUNK, CHUNK):
        journal.append(first, rows(first, CHUNK))
    return journal


def read(path):
    """All rows of a journal, each as it was journal_of; and what is missing."""
    journal = Journal(path)
    parts = list(journal.rows())
    for first, part in parts:
        assert_array_equal(part, rows(first, len(part)))
    return ([first for first, _ in parts], sum(len(part) for _, part in parts), journal.missing)


def test_rows_come_back(tmp_path):
    path = tmp_path / "new" / "run.mcap"
    journal = journal_of(path)
    assert read(path)[1] == 600 and "no end" in read(path)[2][0]  # readable while it is journal_of
    journal.close()
    assert read(path) == ([0, 100, 200, 300, 400, 500], 600, [])
    assert Journal(path).about == {"seed": 3}
    journal = JournalFile(path, {"seed": 4})  # begins anew
    assert read(path)[1] == 0 and Journal(path).about == {"seed": 4}


def test_rows_of_other_widths_may_follow(tmp_path):
    journal = JournalFile(tmp_path / "run.mcap", {})
    journal.append(0, rows(0, 3))
    journal.append(3, np.zeros(2, np.dtype([("tick", "<i8"), ("numbers", "<f8", (130,))])))
    (_, first), (_, second) = Journal(tmp_path / "run.mcap").rows()
    assert first.dtype == ROW and second["numbers"].shape == (2, 130)


def test_a_cut_file_loses_the_chunk_of_the_cut(tmp_path):
    path = tmp_path / "run.mcap"
    journal_of(path)
    whole = path.read_bytes()
    size = len(whole) // 6
    for cut in range(1000, len(whole), 3011):
        path.write_bytes(whole[:cut])
        firsts, count, missing = read(path)
        assert count >= (cut // size - 1) * CHUNK and firsts == list(range(0, count, CHUNK))
        assert "cut short" in missing[-1]
    assert count == 500


def test_flipped_bits_cost_their_chunk_and_are_reported(tmp_path):
    path = tmp_path / "run.mcap"
    journal_of(path).close()
    whole = path.read_bytes()
    rng = random.Random(1)
    noticed = 0
    for _ in range(100):
        damaged = bytearray(whole)
        damaged[rng.randrange(len(whole))] ^= 1 << rng.randrange(8)
        path.write_bytes(damaged)
        try:
            _, count, missing = read(path)
        except RecordingError as error:  # its first bytes
            assert "damaged where it begins" in str(error)
            continue
        assert count >= 500
        assert count == 600 or missing
        noticed += bool(missing)
    assert noticed > 90


# What runs and sweeps leave in files: one writer at a time, damage named, nobody left behind.


def test_a_second_run_in_a_folder_is_refused_and_the_first_keeps_its_rows(tmp_path):
    line = f"run two_contact_rod --duration 60 --out {tmp_path}"
    with started([*COMMAND, *line.split()]) as process:
        try:
            rows = tmp_path / "unfinished.mcap"
            wait_until(rows.exists, process=process)
            process.send_signal(signal.SIGSTOP)  # it need not run on to hold its folder
            number = rows.stat().st_ino
            message = refused("run two_contact_rod --duration 1.2 --out", tmp_path)
            assert process.poll() is None and rows.stat().st_ino == number
        finally:
            process.kill()
    assert "another program writes to" in message and "--out" in message, message
    with sole_user(tmp_path):  # the lock ends with its process
        assert rows.exists()


def test_rows_of_chunks_that_come_again_are_read_once(tmp_path):
    path = tmp_path / "unfinished.mcap"
    journal = JournalFile(path, {"name": "x"})
    for first, count in ((0, 5), (0, 5), (5, 3), (3, 7), (10, 1), (10, 1)):
        journal.append(first, rows(first, count))
    journal.close()
    firsts, count, missing = read(path)
    assert (firsts, count) == ([0, 5, 8, 10], 11)
    assert missing == [
        f"ticks {part} come again, and are left out there"
        for part in ("0 to 4", "3 to 7", "10 to 10")
    ]


def study_of(samples=4):
    return SweepStudy.of("two_contact_rod", ["seed=integers(0, 9)"], samples)


def row_of(number):
    return {"row": number, "seed": number, "word": "HELD", "failed": False, "why": "", "x": 0.5}


def write(path, study, *rows):
    file = RowFile(path, study)
    for row in rows:
        file.append(row)
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


@parametrize("at", [1, 3])
@parametrize("kind", DAMAGE)
def test_runs_of_damaged_rows_are_made_again_and_a_damaged_head_is_refused(kind, at, tmp_path):
    path = tmp_path / "rows.jsonl"
    study = study_of()
    write(path, study, *map(row_of, range(3)))
    lines = path.read_bytes().splitlines()
    lines[at - 1] = DAMAGE[kind](lines[at - 1])
    path.write_bytes(b"\n".join(lines) + b"\n")
    damaged = path.read_bytes()
    if at == 1:
        with invalid_input(r"rows\.jsonl holds .* first line is damaged.* remove it"):
            RowFile(path, study)
        assert path.read_bytes() == damaged
        return
    assert sorted(write(path, study, row_of(1)).done) == [0, 1, 2]
    assert write(path, study).done == {number: row_of(number) for number in range(3)}


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
    file.append(row_of(0))
    file.close()
    other = SweepStudy.of("two_contact_rod", ["seed=integers(0, 99)"], 4)
    with path.open("ab") as unfinished:
        unfinished.write(b'{"row": 1')
    before = path.read_bytes()
    for _ in range(2):  # a refusal holds nothing, and changes nothing
        with invalid_input("another study"):
            RowFile(path, other)
        assert path.read_bytes() == before
    assert write(path, study).done == {0: row_of(0)}


def test_metrics_of_a_recording_without_meta_name_what_is_missing():
    channels = {"t": np.arange(2000) * 1e-3, "alpha_true": np.zeros((2000, 2))}
    for meta, words in (
        ({}, "meta has no 'contact_names', but nothing"),
        ({"contact_names": ["left", "right"]}, "has no 'control_rate_hz', but contact_names;"),
    ):
        with recording_error(words):
            osc.metrics(Recording(meta, channels))


def test_recordings_hold_no_folder_and_are_shown_with_the_scenarios(tmp_path, monkeypatch):
    home = tmp_path / "home" / "somebody"
    shown = tmp_path / "elsewhere"
    for folder in (home, shown):
        folder.mkdir(parents=True)
    packaged = osc.load_scenario("two_contact_rod")
    text = packaged.source.read_text()
    shutil.copy(robots.urdf_path("rod"), home / "my_rod.urdf")
    (home / "mine.yaml").write_text(text.replace(packaged.object.urdf, "my_rod.urdf"))
    recording = run_of(home / "mine.yaml", duration=0.05, journal=shown / "unfinished.mcap")
    path = recording.save(shown / "run.npz")
    for file in (path, shown / "run.times.npz"):
        archive = zipfile.ZipFile(file)
        assert not any(b"somebody" in archive.read(name) for name in archive.namelist())
    assert b"somebody" not in (shown / "unfinished.mcap").read_bytes()
    monkeypatch.chdir(tmp_path)
    page = tmp_path / "page.html"
    for name in ("run.npz", "unfinished.mcap"):
        message = refused("view", shown / name, "--html", page)
        assert "copy them beside the recording" in message and "--folder" in message, message
        done("view", shown / name, "--html", page, "--folder", home)
    assert len(osc.recover(shown / "unfinished.mcap", home)) == 50
    shutil.copy(home / "my_rod.urdf", shown)
    done("view", path, "--html", page)
