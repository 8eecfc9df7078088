"""Journals: what was appended survives kills, cuts, flipped bits and full disks."""

import random
import resource
import subprocess
import sys
from pathlib import Path
from time import sleep

import numpy as np
from journal_writer import ROW, rows
from mcap.reader import make_reader
from numpy.testing import assert_array_equal
from pytest import mark, raises

from osc_contact.errors import RecordingError
from osc_contact.recorder.journal import Journal, JournalFile

WRITER = [sys.executable, str(Path(__file__).with_name("journal_writer.py"))]
CHUNK = 100


def written(path, chunks=6, k=CHUNK):
    journal = JournalFile(path, {"seed": 3})
    for chunk in range(chunks):
        journal.append(chunk * k, rows(chunk * k, k))
    return journal


def read(path):
    """All rows of a journal, each as it was written; and what is missing."""
    journal = Journal(path)
    parts = list(journal.rows())
    for first, part in parts:
        assert_array_equal(part, rows(first, len(part)))
    return [first for first, _ in parts], sum(len(part) for _, part in parts), journal.missing


def test_rows_come_back(tmp_path):
    path = tmp_path / "new" / "run.mcap"
    journal = written(path)
    assert read(path)[1] == 600 and "no end" in read(path)[2][0]  # readable while it is written
    journal.close()
    assert read(path) == ([0, 100, 200, 300, 400, 500], 600, [])
    assert Journal(path).about == {"seed": 3}
    journal = JournalFile(path, {"seed": 4})  # begins anew
    assert read(path)[1] == 0 and Journal(path).about == {"seed": 4}


def test_a_temporary_journal_is_read_while_it_grows():
    journal = JournalFile(None, {})
    for chunk in range(3):
        journal.append(chunk * CHUNK, rows(chunk * CHUNK, CHUNK))
        parts = list(journal.read().rows())
        assert [first for first, _ in parts] == [k * CHUNK for k in range(chunk + 1)]
    assert_array_equal(parts[2][1], rows(200, CHUNK))


def test_rows_of_other_widths_may_follow(tmp_path):
    journal = JournalFile(tmp_path / "run.mcap", {})
    wide = np.zeros(2, np.dtype([("tick", "<i8"), ("numbers", "<f8", (130,))]))
    journal.append(0, rows(0, 3))
    journal.append(3, wide)
    (_, first), (_, second) = Journal(tmp_path / "run.mcap").rows()
    assert first.dtype == ROW and second["numbers"].shape == (2, 130)


def test_it_is_an_mcap_file(tmp_path):
    journal = written(tmp_path / "run.mcap")
    journal.close()
    with open(tmp_path / "run.mcap", "rb") as file:
        found = [channel.topic for _, channel, _ in make_reader(file).iter_messages()]
    assert sorted(found) == ["about"] * 2 + ["rows"] * 6


def test_a_cut_file_loses_the_chunk_of_the_cut(tmp_path):
    path = tmp_path / "run.mcap"
    written(path)
    whole = path.read_bytes()
    size = len(whole) // 6
    for cut in range(1000, len(whole), 3011):
        path.write_bytes(whole[:cut])
        firsts, count, missing = read(path)
        assert count >= (cut // size - 1) * CHUNK and firsts == list(range(0, count, CHUNK))
        assert "cut short" in missing[-1]
    assert count == 500


def test_flipped_bits_cost_their_chunk_and_are_told(tmp_path):
    path = tmp_path / "run.mcap"
    journal = written(path)
    journal.close()
    whole = path.read_bytes()
    rng = random.Random(1)
    told = 0
    for _ in range(100):
        damaged = bytearray(whole)
        damaged[rng.randrange(len(whole))] ^= 1 << rng.randrange(8)
        path.write_bytes(bytes(damaged))
        try:
            _, count, missing = read(path)
        except RecordingError as error:  # its first bytes
            assert "damaged where it begins" in str(error)
            continue
        assert count >= 500
        assert count == 600 or missing
        told += bool(missing)
    assert told > 90


@mark.parametrize("content", [b"", b"x" * 5000, b"\x89MCAP0\r\n", bytes(100000)])
def test_other_files_are_refused(tmp_path, content):
    path = tmp_path / "run.mcap"
    path.write_bytes(content)
    with raises(RecordingError, match=r"run\.mcap is no recording"):
        Journal(path)
    with raises(RecordingError, match="no recording"):
        Journal(tmp_path / "none.mcap")


def test_what_was_said_to_be_written_survives_a_kill(tmp_path):
    rng = random.Random(2)
    for kill in range(8):
        path = tmp_path / f"{kill}.mcap"
        with subprocess.Popen([*WRITER, path], stdout=subprocess.PIPE, text=True) as process:
            assert process.stdout is not None
            process.stdout.readline()
            sleep(rng.uniform(0.0, 0.1))
            process.kill()
            said = int(([f"{CHUNK}", *process.stdout.read().split()])[-1])
        assert read(path)[1] - said in (0, CHUNK)  # the last chunk may be written and not yet said


def test_a_full_disk_is_told_once_and_loses_nothing_before(tmp_path):
    path = tmp_path / "run.mcap"
    limit = 1_000_000

    def small():
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))

    done = subprocess.run(
        [*WRITER, path, "100", "50"],
        stdout=subprocess.PIPE,
        text=True,
        preexec_fn=small,
        check=True,
    )
    *said, complaint = done.stdout.splitlines()
    assert complaint == f"recording stops after {said[-1]} ticks: {path}: File too large"
    assert read(path)[1] == int(said[-1]) and path.stat().st_size > limit - 100_000


def test_a_folder_that_cannot_be_made_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    with raises(RecordingError, match="cannot begin"):
        JournalFile(tmp_path / "file" / "run.mcap", {})
