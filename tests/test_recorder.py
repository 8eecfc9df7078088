"""Recording: exact round trip, never half a file, damage refused."""

import io
import json
import os
import zipfile

import numpy as np
from complaints import recording_error
from numpy.testing import assert_array_equal
from pytest import mark, raises

from osc_contact.errors import RecordingError
from osc_contact.recorder import Recording

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


@mark.parametrize(
    "make, message",
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
    with recording_error(message):
        make()


def assert_same(one, other):
    assert one.meta == other.meta and one.channels.keys() == other.channels.keys()
    for name, values in other.channels.items():
        assert one[name].dtype == values.dtype
        assert_array_equal(one[name], values)


def test_round_trip(tmp_path):
    recording = record()
    path = recording.save(tmp_path / "new" / "run.npz")
    loaded = Recording.load(path)
    assert recording.meta == json.loads(json.dumps(META)) and "q" in loaded
    assert_same(loaded, recording)
    assert os.listdir(path.parent) == ["run.npz"]


def test_an_empty_recording_survives(tmp_path):
    empty = Recording(META, {})
    assert len(Recording.load(empty.save(tmp_path / "empty.npz"))) == 0


def test_a_folder_that_is_a_file_is_refused(tmp_path):
    (tmp_path / "out").write_text("")
    with recording_error("cannot write the recording"):
        record().save(tmp_path / "out" / "run.npz")


def written(save, *given, **arrays):
    """What a function of NumPy writes."""
    stream = io.BytesIO()
    save(stream, *given, **arrays)
    return stream.getvalue()


def npz(about, **arrays):
    return written(np.savez, meta=np.array(about), **arrays)


@mark.parametrize(
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


def test_damaged_files_never_give_other_data(tmp_path):
    recording = record()
    path = tmp_path / "run.npz"
    whole = recording.save(path).read_bytes()
    rng = np.random.default_rng(1)
    for size in range(0, len(whole), 37):
        path.write_bytes(whole[:size])
        with raises(RecordingError):
            Recording.load(path)
    refused = 0
    for _ in range(400):
        damaged = bytearray(whole)
        damaged[rng.integers(len(whole))] ^= 1 << int(rng.integers(8))
        path.write_bytes(damaged)
        try:
            loaded = Recording.load(path)
        except RecordingError:
            refused += 1
            continue
        assert_same(loaded, recording)
    assert refused > 250


def test_the_same_content_makes_the_same_bytes_with_times_apart(tmp_path):
    made = []
    for run in ("first", "second"):
        spent = {"wall_s": 1.0 + len(run), "cpu_s": 2.0}
        channels = {**record().channels, "tick_s": np.full(5, 1.0 + len(run)), "last": np.arange(5)}
        recording = Recording({**META, **spent}, channels)
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
    monkeypatch.setattr("osc_contact.recorder.recording.IN_MEMORY", 1000)
    loaded = Recording.load(path)
    assert len(loaded) == 10000 and loaded.meta == json.loads(json.dumps(META))
    path.unlink()  # whoever has it open goes on reading
    for name, values in whole.channels.items():
        assert loaded.channels.columns[name].nbytes == values.nbytes
        assert_array_equal(loaded[name], values)
        assert_array_equal(loaded.rows(7, 9, name)[name], values[7:9])
        assert_array_equal(loaded.at(-1)[name], values[-1])
    monkeypatch.setattr("osc_contact.recorder.recording._FROM_DISK", 3000)
    pieces = list(loaded.pieces("q", "t"))
    assert [len(piece["t"]) for piece in pieces] == [3000, 3000, 3000, 1000]
    assert_array_equal(np.concatenate([piece["q"] for piece in pieces]), loaded["q"])
    thin = loaded.thinned(4000)
    assert len(thin) == 3334 and loaded.thinned(10000) is loaded
    assert_array_equal(thin["q"], loaded["q"][::3])
    again = loaded.save(tmp_path / "again.npz").read_bytes()
    assert again == whole.save(tmp_path / "third.npz").read_bytes()


def test_a_large_file_with_a_flipped_bit_is_refused(tmp_path, monkeypatch):
    path = record(10000).save(tmp_path / "run.npz")
    monkeypatch.setattr("osc_contact.recorder.recording.IN_MEMORY", 1000)
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 4
    path.write_bytes(content)
    with recording_error("checksum of"):
        Recording.load(path)


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


@mark.parametrize("broken", ["os.replace", "os.fsync", "zipfile.ZipFile.open"])
@mark.parametrize("error", [OSError("disk full"), KeyboardInterrupt("stopped")])
def test_a_failed_save_keeps_the_older_file_and_leaves_nothing_else(
    tmp_path, monkeypatch, broken, error
):
    path = record(2).save(tmp_path / "run.npz")

    def fail(*args, **kwargs):
        raise error

    with monkeypatch.context() as patch:
        patch.setattr(broken, fail)
        wanted = RecordingError if isinstance(error, OSError) else KeyboardInterrupt
        with raises(wanted, match=str(error)):
            record(4).save(path)
    assert len(Recording.load(path)) == 2 and os.listdir(tmp_path) == ["run.npz"]
