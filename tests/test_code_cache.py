"""The cache of machine code: fresh after any edit of the law, and compiled anew when damaged."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import osc_contact
from osc_contact.law import limits
from osc_contact.law.compiled import rows
from osc_contact.law.jit import PLAIN_PYTHON

ENTRIES = """
from osc_contact.law.jit import entry

@entry
def kernel(x):
    return 2 * x + 1

@entry
def other(x):
    return 2 - 7 * x
"""

#: Starts a program as often as there are kinds of damage, on a cache that was damaged in that way.
DAMAGED = """
import importlib.util, json, logging, pickle, shutil, sys
from pathlib import Path

folder = Path(sys.argv[1])
lines = []

class Lines(logging.Handler):
    def emit(self, record):
        lines.append(record.getMessage())

logging.getLogger("osc_contact.law").addHandler(Lines())

def start():
    spec = importlib.util.spec_from_file_location("entries", folder / "entries.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module

def flipped(content):
    middle = len(content) // 2
    return content[:middle] + bytes([content[middle] ^ 16]) + content[middle + 1 :]

def become_folder(path):
    path.unlink()
    path.mkdir()

KINDS = {
    "half": lambda path: path.write_bytes(path.read_bytes()[: path.stat().st_size // 2]),
    "empty": lambda path: path.write_bytes(b""),
    "zeros": lambda path: path.write_bytes(bytes(path.stat().st_size)),
    "text": lambda path: path.write_text("<html>404</html>"),
    "pickle": lambda path: path.write_bytes(pickle.dumps({"of": "another program"})),
    "flipped": lambda path: path.write_bytes(flipped(path.read_bytes())),
    "other": lambda path: shutil.copy(next(cache.rglob("*.other-*" + path.suffix)), path),
    "gone": Path.unlink,
    "folder": become_folder,
}
cache, sound, found = folder / "cache", folder / "sound", {}
first = start()
first.kernel(3), first.other(3)
cache.rename(sound)
for end in ("nbi", "nbc"):
    for kind, damage in KINDS.items():
        shutil.rmtree(cache, ignore_errors=True)
        shutil.copytree(sound, cache)
        (path,) = cache.rglob(f"*.kernel-*.{end}")
        lines.clear()
        damage(path)
        outcome = {}
        try:
            outcome["value"] = start().kernel(3)
            outcome["lines"] = list(lines)
            again = start()
            outcome["again"] = again.kernel(3)
            outcome["kept"] = sum(again.kernel.stats.cache_hits.values())
        except Exception as error:
            outcome["error"] = repr(error)
        found[f"{kind}.{end}"] = outcome
print(json.dumps(found))
"""

#: What numba takes for no entry at all: no file, an index of another numba or of other signatures.
QUIET = {"gone.nbi", "gone.nbc", "pickle.nbi", "other.nbi", "flipped.nbi"}

USES_THE_LAW = """
import numpy as np
from osc_contact.law.jit import entry
from osc_contact.law.limits import dot

@entry
def square(x):
    return dot(x, x, x.size)

def result():
    value = square(np.array([1.0, 2.0]))
    return [value, sum(square.stats.cache_hits.values())]
"""


def run(*command, folder=None, **environment):
    """What a Python process prints that is started in a folder."""
    usual = {**os.environ, "NUMBA_DISABLE_JIT": "0"}
    done = subprocess.run(
        [sys.executable, *map(str, command)],
        capture_output=True,
        text=True,
        timeout=300,
        cwd=folder,
        env=usual | {name: str(value) for name, value in environment.items()},
    )
    assert done.returncode == 0, done.stderr[-3000:]
    return done.stdout


def test_a_damaged_cache_is_compiled_anew_with_one_line(tmp_path):
    (tmp_path / "entries.py").write_text(ENTRIES)
    found = json.loads(run("-c", DAMAGED, tmp_path, NUMBA_CACHE_DIR=tmp_path / "cache"))
    assert len(found) == 18
    for kind, outcome in found.items():
        assert "error" not in outcome, f"{kind}: {outcome}"
        assert outcome["value"] == outcome["again"] == 7, kind
        if kind.startswith("folder"):  # a folder stands where the file belongs: nothing is kept
            continue
        assert outcome["kept"] == 1, f"{kind}: it is whole again at the next start"
        assert len(outcome["lines"]) <= 1, kind
        if kind not in QUIET:
            assert "compiled anew" in "".join(outcome["lines"]), kind


def test_an_edit_of_any_source_of_the_law_has_its_entries_compiled_anew(tmp_path):
    package = tmp_path / "osc_contact"
    source = Path(osc_contact.__file__).parent
    shutil.copytree(source, package, ignore=shutil.ignore_patterns("__pycache__", "files"))
    (tmp_path / "uses_the_law.py").write_text(USES_THE_LAW)
    show = "import uses_the_law as u, json; print(json.dumps(u.result()))"

    def result():
        cache = tmp_path / "cache"
        return json.loads(
            run("-c", show, folder=tmp_path, PYTHONPATH=tmp_path, NUMBA_CACHE_DIR=cache)
        )

    assert result() == [5.0, 0]
    assert result() == [5.0, 1], "loaded, not compiled"
    edited = package / "law" / "limits.py"
    edited.write_text(edited.read_text().replace("s += a[i] * b[i]", "s += a[i] * b[i] + 1.0"))
    assert result() == [7.0, 0]


@pytest.mark.skipif(PLAIN_PYTHON, reason="nothing is compiled, so nothing is cached")
def test_all_entries_of_the_law_are_cached_in_this_way():
    from osc_contact.law.code_cache import CodeCache

    entries = limits.prepare, limits.finish, limits.fill_program, limits.settle, rows()
    assert [type(entry._cache) for entry in entries] == 5 * [CodeCache]


def test_a_numba_with_another_cache_compiles_in_every_process():
    script = (
        "from numba.core.caching import IndexDataCacheFile\n"
        "del IndexDataCacheFile._dump\n"
        "from osc_contact.law import jit\n"
        "square = jit.entry(lambda x: x * x)\n"
        "print(square(3), type(square._cache).__name__)"
    )
    assert run("-c", script).split() == ["9", "NullCache"]
