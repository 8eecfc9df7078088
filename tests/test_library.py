"""The law as a library: made once, found where it fits, and bit for bit what numba compiles."""

import hashlib
import logging
import os
import shutil
import threading
from pathlib import Path

import numpy as np
from processes import completed, python
from pytest import fixture, mark, param, raises
from samples import module_fixture, names_in, parametrize
from scenario_runs import run_of

import osc_contact as osc
from osc_contact.law import c_object, jit, library
from osc_contact.law.compiled import report_to

pytestmark = mark.skipif(jit.PLAIN_PYTHON, reason="nothing is compiled, so there is no library")
TASKS = ("two_contact_rod", "limited_rod")
RUN = """
import sys
sys.modules["numba"] = sys.modules["llvmlite"] = None
import osc_contact as osc
from test_library import numbers_of
for name in sys.argv[1:]:
    print(name, numbers_of(name))
from osc_contact.law import jit
assert jit.READY is not None
"""
ONE_TICK = """
import sys
import numpy as np
import osc_contact as osc
from osc_contact.law import jit
rig = osc.build_rig(osc.load_scenario("two_contact_rod"))
m = rig.plant().measure()
at = rig.references.at(0.0)
kinds = {
    "plain": np.array,
    "lists": lambda x: np.asarray(x).tolist(),
    "single": lambda x: np.asarray(x, np.float32).astype(np.float32),
    "strided": lambda x: np.repeat(x, 2, axis=-1)[..., ::2],
    "read only": lambda x: np.frombuffer(np.asarray(x).tobytes()).reshape(np.shape(x)),
    "nan": lambda x: np.full_like(x, np.nan),
    "short": lambda x: np.asarray(x)[:-1],
}
for name, kind in kinds.items():
    controller = rig.controller()
    controller.tick(m, at)
    tau = controller.tick(osc.Measurement(kind(m.q), kind(m.v), kind(m.wrenches)), at)
    assert np.isfinite(tau).all()
    print(name, controller.status.name, *tau.round(4), sep=",")
assert (jit.READY is None) == (sys.argv[1] == "jit")
"""


def test_tests_of_the_library_are_left_out_only_where_another_way_is_requested():
    """Five files skip what needs a library: without a C compiler they would do so unnoticed."""
    requested = os.environ.get("OSC_CONTACT_LAW") == "jit"
    assert jit.HAS_LIBRARY or requested, "no library can be made: is there a C compiler?"


@module_fixture
def made():
    """The library as a file, also where the tests themselves run in numba's usual way."""
    if jit.READY is None and jit.UNITS is None:
        program = "from osc_contact.law.c_object import jit; print(jit.the_library().__file__)"
        return Path(printed(program, "")[-1])
    return Path(jit.the_library().__file__)


def printed(program, library, *arguments):
    """Lines that a Python with this library prints."""
    return python("-c", program, *arguments, OSC_CONTACT_LAW=str(library)).stdout.splitlines()


def numbers_of(name):
    """A digest of all that a short run records, but times of the clock."""
    recording = run_of(name, duration=0.25)
    found = hashlib.sha256()
    for channel in sorted(recording.channels):
        if channel != "tick_s":
            found.update(np.ascontiguousarray(recording[channel]).tobytes())
    return found.hexdigest()


def test_runs_without_numba_are_equal_to_the_bit(made):
    of_library = dict(line.split() for line in printed(RUN, made, *TASKS))
    assert of_library == {name: numbers_of(name) for name in TASKS}
    assert len(set(of_library.values())) == len(TASKS)


@parametrize("where", ["library", param("jit", marks=mark.slow)])
def test_arrays_of_other_kinds_end_as_they_should(made, where):
    lines = printed(ONE_TICK, made if where == "library" else where, where)
    ends = {line.split(",")[0]: line.split(",")[1:] for line in lines}
    assert ends.pop("nan")[0] == ends.pop("short")[0] == "HELD"
    plain = ends.pop("plain")
    assert plain[0] == "OK" and len(ends) == 4
    assert ends.pop("single")[0] == "OK"
    assert all(end == plain for end in ends.values())


def test_a_library_that_is_named_and_does_not_fit_is_refused(made, tmp_path, monkeypatch):
    refused = "is no library of this law for this platform"
    content = made.read_bytes()
    law = library.law_hash().encode()
    assert content.count(law) == 1
    other = law[:-1] + (b"0" if law[-1:] != b"0" else b"1")
    contents = {"fits": content, "other sources": content.replace(law, other), "damaged": b"ELF"}
    for name, one in contents.items():
        path = tmp_path / f"{len(one)}{name[0]}.so"
        path.write_bytes(one)
        monkeypatch.setenv("OSC_CONTACT_LAW", str(path))
        if name == "fits":
            assert library.found() is not None
            continue
        with raises(osc.OscContactError, match=refused):
            library.found()


def test_a_library_that_is_named_and_not_there_is_missed(tmp_path, monkeypatch):
    monkeypatch.setenv("OSC_CONTACT_LAW", str(tmp_path / "law.so"))
    with raises(osc.OscContactError, match=r"OSC_CONTACT_LAW names .*law.so, which is not there"):
        library.found()


FOREIGN = """
#include <stdio.h>
__attribute__((constructor)) static void run(void) { fclose(fopen("MARK", "w")); }
"""


def test_a_foreign_library_is_refused_before_it_runs(tmp_path, monkeypatch):
    ran = tmp_path / "it_ran"
    (tmp_path / "foreign.c").write_text(FOREIGN.replace("MARK", str(ran)))
    foreign = tmp_path / "foreign.so"
    completed("cc", "-shared", "-fPIC", tmp_path / "foreign.c", "-o", foreign)
    monkeypatch.setenv("OSC_CONTACT_LAW", str(foreign))
    with raises(osc.OscContactError, match="is no library of this law"):
        library.found()
    assert not ran.exists()


def test_a_library_is_not_taken_from_where_others_may_write(tmp_path, caplog):
    folder = tmp_path / "cache" / "law-x"
    folder.mkdir(parents=True, mode=0o700)
    assert library.may_keep(folder) and library.may_keep(folder.parent)
    folder.parent.chmod(0o777)
    (folder / library.LIBRARY).write_bytes(b"")
    with caplog.at_level(logging.WARNING):
        assert library.found_in(folder) is None
    assert f"other users may write to {folder.parent}" in caplog.text


def test_an_edit_of_any_source_of_the_law_is_another_library(made, tmp_path, monkeypatch):
    monkeypatch.setattr(library, "__file__", str(tmp_path / "law" / "library.py"))
    shutil.copytree(c_object.__file__.rpartition("/")[0], tmp_path / "law")
    hashes = set()
    for name in ("library.py", "tick.py", "limits.py", "units.py", "extension.c"):
        library.law_hash.cache_clear()
        hashes.add(library.law_hash())
        assert (library.load(made) is not None) == (name == "library.py")
        path = tmp_path / "law" / name
        path.write_text(path.read_text() + "\n")
    monkeypatch.undo()
    library.law_hash.cache_clear()
    assert len(hashes) == 5 and library.load(made) is not None


# --- Made when first used -------------------------------------------------------------------------


@fixture
def workshop(made, tmp_path, monkeypatch):
    """An empty cache, where the object is the one that is there: `calls` counts compilations."""
    calls = []

    def code(show):
        calls.append(show)
        return made.with_name(library.OBJECT).read_bytes()

    monkeypatch.setenv("OSC_CONTACT_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(jit, "UNITS", object())
    monkeypatch.setattr(c_object, "_object", code)
    return calls


def test_the_library_is_made_once_and_kept(workshop, tmp_path):
    lines = []
    shares = []
    report_to(lines.append, shares.append)
    try:
        assert library.found_in(library.kept()) is None
        threads = [threading.Thread(target=c_object.make) for _ in range(3)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert len(workshop) == 1 and shares == [0.0, 1.0]
        assert lines[0].startswith("compiling the control tick") and len(lines) == 2
        first = Path(c_object.make().__file__)
        assert len(workshop) == 1 and first.is_relative_to(tmp_path / "cache")
        assert names_in(first.parent) == {
            library.LIBRARY,
            library.OBJECT,
            library.CHECKSUM,
        }
    finally:
        report_to(lambda text: None)


DAMAGE = {
    "half": lambda content: content[: len(content) // 2],
    "empty": lambda content: b"",
    "flipped": lambda content: content[:-1] + bytes([content[-1] ^ 1]),
    "text": lambda content: b"<html>404</html>",
    "gone": None,
}


@parametrize("name", [library.LIBRARY, library.OBJECT, library.CHECKSUM])
@parametrize("kind", DAMAGE)
def test_a_damaged_library_is_made_anew(workshop, kind, name):
    path = Path(c_object.make().__file__).with_name(name)
    content = path.read_bytes()
    path.unlink()  # the bytes that are loaded stay
    if DAMAGE[kind] is not None:
        path.write_bytes(DAMAGE[kind](content))
    assert library.found_in(path.parent) is None
    assert c_object.make() is not None and len(workshop) == 2
    assert library.found_in(path.parent) is not None


def test_old_libraries_are_removed(workshop, tmp_path):
    for k in range(c_object.KEPT + 3):
        folder = tmp_path / "cache" / f"law-{k}"
        folder.mkdir(parents=True)
        os.utime(folder, (k, k))
    path = Path(c_object.make().__file__)
    left = names_in(tmp_path / "cache") - {".lock"}
    assert left == {path.parent.name} | {f"law-{k}" for k in range(4, c_object.KEPT + 3)}


def test_a_cache_that_cannot_be_written_costs_a_line(workshop, tmp_path, caplog):
    (tmp_path / "cache").write_text("a file")
    with caplog.at_level(logging.WARNING):
        assert library.law_hash() == c_object.make().LAW
    assert "every process compiles it" in caplog.text


def test_a_lock_that_is_a_link_does_not_empty_its_target(workshop, tmp_path, caplog):
    cache = tmp_path / "cache"
    cache.mkdir(mode=0o700)
    (tmp_path / "thesis").write_text("years of work")
    (cache / ".lock").symlink_to(tmp_path / "thesis")
    with caplog.at_level(logging.WARNING):
        assert library.law_hash() == c_object.make().LAW
    assert (tmp_path / "thesis").read_text() == "years of work"
    assert "every process compiles it" in caplog.text and names_in(cache) == {".lock"}


@parametrize("mode", [0o777, 0o770])
def test_nothing_is_kept_where_others_may_write(workshop, tmp_path, caplog, mode):
    cache = tmp_path / "cache"
    cache.mkdir()
    cache.chmod(mode)
    with caplog.at_level(logging.WARNING):
        assert library.law_hash() == c_object.make().LAW
    assert names_in(cache) == set()
    assert f"other users may write to {cache}: chmod go-w {cache}" in caplog.text


def test_a_compiler_that_fails_is_quoted(workshop, monkeypatch):
    monkeypatch.setattr(library, "COMPILER", "false")
    with raises(osc.OscContactError, match="the C compiler cannot build the law"):
        c_object.make()
    assert library.found_in(library.kept()) is None


def test_what_is_missing_is_named(monkeypatch, tmp_path):
    assert library.missing_tool() == ""
    monkeypatch.setattr(library, "HEADERS", str(tmp_path))
    assert "Python.h" in library.missing_tool()
    monkeypatch.setattr(library, "COMPILER", "no-such-compiler")
    assert "no-such-compiler" in library.missing_tool()


def test_without_numba_and_without_a_library_the_cure_is_named():
    program = "import sys; sys.modules['numba'] = None\n"
    program += "try:\n    from osc_contact import Controller\nexcept ImportError as e: print(e)"
    (line,) = printed(program, "jit")
    cure = "not compiled here, and numba is not installed: pip install 'osc-contact[law]'"
    assert cure in line
