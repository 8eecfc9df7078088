"""Journals: what was appended survives cuts and flipped bits; kills: see test_recovery."""

import random

import numpy as np
from numpy.testing import assert_array_equal

from osc_contact.errors import RecordingError
from osc_contact.recorder.journal import Journal, JournalFile

CHUNK = 100
ROW = np.dtype([("tick", "<i8"), ("numbers", "<f8", (120,))])


def rows(first, k):
    """Rows that say what they ought to hold."""
    out = np.zeros(k, ROW)
    out["tick"] = np.arange(first, first + k)
    out["numbers"] = np.sin(out["tick"])[:, None] + np.arange(120)
    return out


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


def test_rows_of_other_widths_may_follow(tmp_path):
    journal = JournalFile(tmp_path / "run.mcap", {})
    wide = np.zeros(2, np.dtype([("tick", "<i8"), ("numbers", "<f8", (130,))]))
    journal.append(0, rows(0, 3))
    journal.append(3, wide)
    (_, first), (_, second) = Journal(tmp_path / "run.mcap").rows()
    assert first.dtype == ROW and second["numbers"].shape == (2, 130)


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
    written(path).close()
    whole = path.read_bytes()
    rng = random.Random(1)
    told = 0
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
        told += bool(missing)
    assert told > 90
