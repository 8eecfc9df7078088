"""The compiled law as WebAssembly: one module for browsers and Node.js, for every `.osc` file.

law.wasm is the law for 32-bit addresses, with the C sources of `without_python` and web_files. It
needs nothing from its surroundings. Wheels bring it; elsewhere it is made when it is first wanted,
and kept in the store of parts under the hash of all that it is made of. The compiler is that of
the package `ziglang` (extra `web`), or clang with lld and wasi-libc.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from hashlib import sha256
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory

from osc_contact.control.without_python import write_sources
from osc_contact.errors import OscContactError
from osc_contact.law import library
from osc_contact.law.store import Store

MODULE = "law.wasm"  #: beside the library of the law, where a wheel brings it
TRIPLE = "wasm32-unknown-wasi"
SOURCES = ("osc_selection.c", "osc_daqp.c", "osc_web.c")  #: the first has osc_controller.c within
STACK = 1 << 20  #: bytes
_FLAGS = ("-O2", "-w", "-std=c11", "-mexec-model=reactor", f"-Wl,-z,stack-size={STACK}")


def law_wasm() -> bytes:
    """The module for the law as it lies here: a wheel's, one that was kept, or a new one.

    Raises:
        OscContactError: there is none, and no compiler to make it, or the compiler fails.
    """
    brought = Path(library.__file__).with_name(MODULE)
    if brought.is_file():
        content = brought.read_bytes()
        if library.law_hash().encode() in content:
            return content
    with TemporaryDirectory() as temporary:
        folder = Path(temporary)
        write_sources(folder)
        for item in (files("osc_contact.control") / "web_files").iterdir():
            if item.name.endswith((".c", ".h")):
                (folder / item.name).write_bytes(item.read_bytes())
        store = Store(library.cache_folder() / "parts")
        key = f"web-{_hash_of(folder)}"
        kept = store.find(key)
        if kept is not None:
            return kept
        made = _made(folder)
    store.keep(key, made)
    return made


def _hash_of(folder: Path) -> str:
    """SHA-256 of the sources in a folder, those of the law, and the options of the compiler."""
    found = sha256(" ".join((library.law_hash(), TRIPLE, *SOURCES, *_FLAGS)).encode())
    for path in sorted(folder.rglob("*")):
        if path.is_file():
            found.update(path.name.encode() + path.read_bytes())
    return found.hexdigest()


def _made(folder: Path) -> bytes:
    """The module of the sources in a folder.

    Raises:
        OscContactError: there is no compiler, or it fails.
    """
    compiler = _compiler()
    _run(
        [sys.executable, "-m", "osc_contact.law.c_object", TRIPLE, str(folder / "law.o")],
        folder,
        OSC_CONTACT_LAW="compile",  # where a library is there, numba would not be loaded
    )
    command = [*compiler, *_FLAGS, "-I.", "-Idaqp/include", *SOURCES, "law.o", "-lm", "-s"]
    cache = str(library.cache_folder() / "zig")
    _run([*command, "-o", MODULE], folder, ZIG_GLOBAL_CACHE_DIR=cache, ZIG_LOCAL_CACHE_DIR=cache)
    return (folder / MODULE).read_bytes()


def _compiler() -> list[str]:
    """Command of a C compiler that has a libc for WebAssembly.

    Raises:
        OscContactError: there is none.
    """
    if find_spec("ziglang") is not None:
        return [sys.executable, "-m", "ziglang", "cc", "-target", "wasm32-wasi"]
    if shutil.which("clang") and shutil.which("wasm-ld"):
        return ["clang", f"--target={TRIPLE.replace('-unknown', '')}", "--sysroot=/usr"]
    raise OscContactError(
        f"{MODULE} is made by a C compiler for WebAssembly, and there is none here: "
        'pip install "osc-contact[web]" brings one (Debian: clang, lld, wasi-libc and '
        "libclang-rt-dev-wasm32)"
    )


def _run(command: Sequence[str], folder: Path, **variables: str) -> None:
    """Run a command in a folder.

    Args:
        command: with its words. folder: to run it in. variables: of the environment, besides this
            process's.

    Raises:
        OscContactError: it fails.
    """
    here = str(Path(__file__).resolve().parents[2])
    paths = os.pathsep.join([here, *filter(None, [os.environ.get("PYTHONPATH")])])
    done = subprocess.run(
        command,
        cwd=folder,
        env={**os.environ, "PYTHONPATH": paths, **variables},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
    )
    if done.returncode != 0:
        raise OscContactError(
            f"{MODULE} cannot be made: {' '.join(command[:4])} … ends with {done.returncode}: "
            f"{done.stderr.strip()[-800:]}"
        )


if __name__ == "__main__":  # FILE: the module for other programs
    if len(sys.argv) == 2:
        Path(sys.argv[1]).write_bytes(law_wasm())
