"""Recorder and recording: exact round trip, fixed capacity, never half a file, damage refused."""

import io
import json
import os
import zipfile

import numpy as np
import pytest

from osc_contact.errors import RecordingError
from osc_contact.recorder import Recorder, Recording

META = {"scenario": {"name": "rod"}, "plant": "rigid", "seed": 3, "arm_names": ("left", "right")}


def record(ticks=5, capacity=8):
    recorder = Recorder(capacity, META)
    for k in range(ticks):
        recorder.append(
            t=0.001 * k, q=np.arange(4.0) + k, closed=np.array([True, k > 2]), status=k,
            contact_point=np.full((2, 3), k + 0.1), squeeze=0 if k == 0 else 0.5,
        )  # fmt: skip
    return recorder.recording()


def test_recorder_keeps_the_filled_part():
    recording = record()
    assert len(recording) == 5
    assert recording["t"].tolist() == [0.0, 0.001, 0.002, 0.003, 0.004]
    assert recording["q"].shape == (5, 4) and recording["q"][4].tolist() == [4, 5, 6, 7]
    assert recording["contact_point"].shape == (5, 2, 3)
    assert recording["closed"].dtype == bool and recording["closed"][:, 1].sum() == 2
    assert recording["status"].dtype == np.int64
    assert recording["squeeze"].tolist() == [0, 0.5, 0.5, 0.5, 0.5]


def test_values_are_copied_in_and_out():
    recorder, q = Recorder(3, {}), np.zeros(2)
    recorder.append(q=q)
    q[:] = 7.0
    early = recorder.recording()
    recorder.append(q=q)
    early["q"][:] = -1.0
    assert recorder.recording()["q"].tolist() == [[0, 0], [7, 7]]


def test_capacity_is_named_and_does_not_grow():
    recorder = Recorder(2, META)
    recorder.append(t=0.0)
    recorder.append(t=1.0)
    with pytest.raises(RecordingError, match=r"capacity of 2 ticks does not grow; .*duration"):
        recorder.append(t=2.0)
    assert recorder.recording()["t"].tolist() == [0.0, 1.0]


@pytest.mark.parametrize(
    ("channels", "message"),
    [
        ({"t": 0.0}, r"missing \['q'\], new \[\]"),
        ({"t": 0.0, "q": np.zeros(2), "v": 1}, r"missing \[\], new \['v'\]"),
        ({"t": 0.0, "q": 1.0}, r"'q' has shape \(\); the first tick had \(2,\)"),
        ({"t": 0.0, "q": np.zeros(3)}, r"shape \(3,\)"),
        ({"t": 0.0, "q": np.zeros(2, complex)}, "complex128, which does not fit"),
        ({"t": "now", "q": np.zeros(2)}, "does not fit the recorded float64"),
    ],
)
def test_a_changed_tick_is_refused_and_not_counted(channels, message):
    recorder = Recorder(4, META)
    recorder.append(t=0.0, q=np.zeros(2))
    with pytest.raises(RecordingError, match=message):
        recorder.append(**channels)
    assert len(recorder) == 1


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Recorder(0, {}), "whole number of ticks >= 1; got 0"),
        (lambda: Recorder(2.5, {}), "got 2.5"),
        (lambda: Recorder(2, {"a": float("nan")}), "JSON-able"),
        (lambda: Recorder(2, {"a": np.zeros(2)}), "JSON-able"),
        (lambda: Recorder(2, {}).append(meta=1.0), "cannot name a channel"),
        (lambda: Recorder(2, {}).append(file=1.0), "cannot name a channel"),
        (lambda: Recorder(2, {}).append(q="abc"), "expected bool, int or float"),
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
    empty = Recorder(3, META).recording()
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
