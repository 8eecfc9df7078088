"""Recording: exact round trip, never half a file, damage refused."""

import io
import json
import os
import zipfile

import numpy as np
import pytest

from osc_contact.errors import RecordingError
from osc_contact.recorder import Recording

META = {"scenario": {"name": "rod"}, "plant": "rigid", "seed": 3, "arm_names": ("left", "right")}


def record(ticks=5):
    k = np.arange(ticks)
    return Recording(META, {
        "t": 0.001 * k,
        "q": np.arange(4.0) + k[:, None],
        "closed": np.column_stack((k >= 0, k > 2)),
        "status": k,
        "contact_point": np.full((ticks, 2, 3), 0.1) + k[:, None, None],
    })  # fmt: skip


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Recording({"a": float("nan")}, {}), "JSON-able"),
        (lambda: Recording({"a": np.zeros(2)}, {}), "JSON-able"),
        (lambda: Recording({}, {"meta": np.ones(2)}), "cannot name a channel"),
        (lambda: Recording({}, {"file": np.ones(2)}), "cannot name a channel"),
        (lambda: Recording({}, {"q": np.zeros(2), "t": np.zeros(3)}), "differ in their number"),
        (lambda: Recording({}, {"q": np.array(1.0)}), "first axis"),
        (lambda: Recording({}, {"q": np.array([None])}), "dtype object"),
        (lambda: record()["qq"], "no channel 'qq' in this recording; there are: t, q"),
    ],
)
def test_bad_input_is_refused(make, message):
    with pytest.raises(RecordingError, match=message):
        make()


def test_round_trip(tmp_path):
    recording = record()
    path = recording.save(tmp_path / "new" / "run.npz")
    loaded = Recording.load(path)
    assert loaded.meta == recording.meta == json.loads(json.dumps(META))
    assert loaded.channels.keys() == recording.channels.keys() and "q" in loaded
    for name, values in recording.channels.items():
        assert loaded[name].dtype == values.dtype
        np.testing.assert_array_equal(loaded[name], values)
    assert os.listdir(path.parent) == ["run.npz"]


def test_an_empty_recording_survives(tmp_path):
    empty = Recording(META, {})
    assert len(Recording.load(empty.save(tmp_path / "empty.npz"))) == 0


@pytest.mark.parametrize("broken", ["os.replace", "os.fsync", "numpy.savez"])
@pytest.mark.parametrize("error", [OSError("disk full"), KeyboardInterrupt()])
def test_a_failed_save_leaves_nothing_behind(tmp_path, monkeypatch, broken, error):
    def fail(*args, **kwargs):
        raise error

    monkeypatch.setattr(broken, fail)
    wanted = RecordingError if isinstance(error, OSError) else KeyboardInterrupt
    with pytest.raises(wanted):
        record().save(tmp_path / "run.npz")
    assert os.listdir(tmp_path) == []


def test_a_failed_save_keeps_the_older_file(tmp_path, monkeypatch):
    path = record(2).save(tmp_path / "run.npz")

    def fail(*args):
        raise OSError("disk full")

    monkeypatch.setattr(os, "replace", fail)
    with pytest.raises(RecordingError, match="disk full"):
        record(4).save(path)
    assert len(Recording.load(path)) == 2 and os.listdir(tmp_path) == ["run.npz"]


def test_a_folder_that_is_a_file_is_refused(tmp_path):
    (tmp_path / "out").write_text("")
    with pytest.raises(RecordingError, match="cannot write the recording"):
        record().save(tmp_path / "out" / "run.npz")


def npz(**arrays):
    stream = io.BytesIO()
    np.savez(stream, **arrays)
    return stream.getvalue()


def npy():
    stream = io.BytesIO()
    np.save(stream, np.zeros(3))
    return stream.getvalue()


@pytest.mark.parametrize(
    "content",
    [
        b"", b"not a recording", npy(), npz(q=np.zeros(3)), npz(meta=np.zeros(2)),
        npz(meta=np.array("{}")), npz(meta=np.array("[1]")), npz(meta=np.array("{")),
        npz(meta=np.array([{"a": 1}], dtype=object)),
        npz(meta=np.array('{"format": 2, "meta": {}}'), q=np.zeros(3)),
        npz(meta=np.array('{"format": 1, "meta": {}}'), q=np.zeros(3), t=np.zeros(2)),
        npz(meta=np.array('{"format": 1, "meta": 5}')),
    ],
    ids=range(12),
)  # fmt: skip
def test_unknown_files_are_refused(tmp_path, content):
    path = tmp_path / "run.npz"
    path.write_bytes(content)
    with pytest.raises(RecordingError, match=r"run\.npz|ticks|meta"):
        Recording.load(path)


def test_missing_files_are_refused(tmp_path):
    with pytest.raises(RecordingError, match="there is no such file"):
        Recording.load(tmp_path / "none.npz")
    with pytest.raises(RecordingError, match="there is no such file"):
        Recording.load(tmp_path)


def test_damaged_files_never_give_other_data(tmp_path):
    recording, path = record(), tmp_path / "run.npz"
    whole = recording.save(path).read_bytes()
    rng = np.random.default_rng(1)
    for size in range(0, len(whole), 37):
        path.write_bytes(whole[:size])
        with pytest.raises(RecordingError):
            Recording.load(path)
    refused = 0
    for _ in range(400):
        damaged = bytearray(whole)
        damaged[rng.integers(len(whole))] ^= 1 << int(rng.integers(8))
        path.write_bytes(bytes(damaged))
        try:
            loaded = Recording.load(path)
        except RecordingError:
            refused += 1
            continue
        assert loaded.meta == recording.meta
        for name, values in recording.channels.items():
            np.testing.assert_array_equal(loaded[name], values)
    assert refused > 250


def test_a_flipped_number_is_found_by_its_checksum(tmp_path):
    path = record().save(tmp_path / "run.npz")
    content = path.read_bytes()
    with zipfile.ZipFile(path) as archive:
        info = archive.getinfo("q.npy")
    at = content.index(np.arange(4.0).tobytes(), info.header_offset)
    path.write_bytes(content[:at] + b"\x01" + content[at + 1 :])
    with pytest.raises(RecordingError, match=r"checksum of q\.npy is wrong"):
        Recording.load(path)
