"""The law as a library made beforehand: bit for bit the compiled one, without numba."""

import hashlib
import os
import subprocess
import sys

import numpy as np
from pytest import fixture, mark

import osc_contact as osc
from osc_contact.law import ready
from osc_contact.law.c_object import build
from osc_contact.law.jit import PLAIN_PYTHON
from osc_contact.law.sources import law_hash

pytestmark = mark.skipif(PLAIN_PYTHON, reason="nothing is compiled, so there is no library")
#: plain, redundant, bars, motor limits, bodies that move, phases
TASKS = {
    "two_contact_rod": [],
    "panda_edge": [],
    "three_arm_plate": [],
    "limited_rod": [],
    "moving_face": [],
    "approach_and_slide": [],
}
RUN = """
import sys
sys.modules["numba"] = sys.modules["llvmlite"] = None
import osc_contact as osc
from test_ready import numbers_of
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


@fixture(scope="session")
def library(tmp_path_factory):
    """Path of the library."""
    folder = tmp_path_factory.mktemp("law")
    build(folder)
    return folder / ready.LIBRARY


def printed(program, library, *arguments):
    """Lines that a Python with this library prints."""
    around = {**os.environ, "OSC_CONTACT_LAW": str(library)}
    around["PYTHONPATH"] = os.pathsep.join([os.path.dirname(__file__), *sys.path])
    command = [sys.executable, "-c", program, *arguments]
    done = subprocess.run(command, capture_output=True, text=True, env=around)
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout.splitlines()


def numbers_of(name):
    """A digest of all that a short run records, but times of the clock."""
    recording = osc.run(osc.load_scenario(name, TASKS[name]), duration=0.25)
    found = hashlib.sha256()
    for channel in sorted(recording.channels):
        if channel != "tick_s":
            found.update(np.ascontiguousarray(recording[channel]).tobytes())
    return found.hexdigest()


def test_runs_are_equal_to_the_bit(library):
    of_library = dict(line.split() for line in printed(RUN, library, *TASKS))
    assert of_library == {name: numbers_of(name) for name in TASKS}
    assert len(set(of_library.values())) == len(TASKS)


def test_arrays_of_other_kinds_end_as_with_the_compiled_law(library):
    given = [printed(ONE_TICK, where, str(where)) for where in (library, "jit")]
    assert given[0] == given[1]
    ends = dict(line.split(",")[:2] for line in given[0])
    assert ends.pop("nan") == ends.pop("short") == "HELD"
    assert set(ends.values()) == {"OK"} and len(ends) == 5


def test_a_library_that_does_not_fit_is_left(library, tmp_path, monkeypatch):
    found = {}
    content = library.read_bytes()
    law = law_hash().encode()
    assert content.count(law) == 1
    other = law[:-1] + (b"0" if law[-1:] != b"0" else b"1")
    contents = {"fits": content, "other sources": content.replace(law, other), "damaged": b"ELF"}
    for name, one in contents.items():
        path = tmp_path / f"{len(one)}{name[0]}.so"
        path.write_bytes(one)
        monkeypatch.setenv("OSC_CONTACT_LAW", str(path))
        found[name] = ready.load() is not None
    assert found == {"fits": True, "other sources": False, "damaged": False}


def test_without_numba_and_without_a_library_the_cure_is_named():
    program = "import sys; sys.modules['numba'] = None\n"
    program += "try:\n    from osc_contact import Controller\nexcept ImportError as e: print(e)"
    (line,) = printed(program, "jit")
    cure = "not compiled here, and numba is not installed: pip install 'osc-contact[law]'"
    assert cure in line
