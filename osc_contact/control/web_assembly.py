"""WebAssembly module of the compiled law, for browsers and Node.js, which runs every `.osc` file.

law.wasm is the law for 32-bit addresses, with the C sources of `without_python` and web_files. It
imports no functions. Wheels contain it; otherwise it is compiled when it is first needed, and kept
in the store of parts under the hash of its sources. The compiler is that of the package `ziglang`
(extra `web`), or clang with lld and wasi-libc.
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

MODULE = "law.wasm"  #: file name; in a wheel it is in the folder of the law's library
TRIPLE = "wasm32-unknown-wasi"
SOURCES = ("osc_selection.c", "osc_daqp.c", "osc_web.c")  #: the first includes osc_controller.c
STACK = 1 << 20  #: size of the stack (bytes)
_FLAGS = ("-O2", "-w", "-std=c11", "-mexec-model=reactor", f"-Wl,-z,stack-size={STACK}")


def law_wasm() -> bytes:
    """Content of the module for the present sources of the law.

    It is read from the wheel if that is of the same sources, else from the store of parts, or
    compiled.

    Raises:
        OscContactError: it has to be compiled, and there is no compiler, or the compiler fails.
    """
    packaged_file = Path(library.__file__).with_name(MODULE)
    if packaged_file.is_file():
        content = packaged_file.read_bytes()
        if library.law_hash().encode() in content:
            return content
    with TemporaryDirectory() as temporary:
        # the sources are written first, because their hash is the key of the stored module
        folder = Path(temporary)
        write_sources(folder)
        for item in (files("osc_contact.control") / "web_files").iterdir():
            if item.name.endswith((".c", ".h")):
                (folder / item.name).write_bytes(item.read_bytes())
        store = Store(library.cache_folder() / "parts")
        key = f"web-{_hash_of(folder)}"
        stored_module = store.find(key)
        if stored_module is not None:
            return stored_module
        module = _compile_module(folder)
    store.keep(key, module)
    return module


def _hash_of(folder: Path) -> str:
    """SHA-256 of the sources in a folder, those of the law, and the options of the compiler."""
    digest = sha256(" ".join((library.law_hash(), TRIPLE, *SOURCES, *_FLAGS)).encode())
    for path in sorted(folder.rglob("*")):
        if path.is_file():
            digest.update(path.name.encode() + path.read_bytes())
    return digest.hexdigest()


def _compile_module(folder: Path) -> bytes:
    """Compile the law and the C sources in a folder to a module; return its content.

    Raises:
        OscContactError: there is no compiler, or it fails.
    """
    compiler = _compiler_command()
    _run_command(
        [sys.executable, "-m", "osc_contact.law.c_object", TRIPLE, str(folder / "law.o")],
        folder,
        OSC_CONTACT_LAW="compile",  # with a ready library of the law, numba would not be loaded
    )
    command = [*compiler, *_FLAGS, "-I.", "-Idaqp/include", *SOURCES, "law.o", "-lm", "-s"]
    cache = str(library.cache_folder() / "zig")
    _run_command(
        [*command, "-o", MODULE], folder, ZIG_GLOBAL_CACHE_DIR=cache, ZIG_LOCAL_CACHE_DIR=cache
    )
    return (folder / MODULE).read_bytes()


def _compiler_command() -> list[str]:
    """Command of a C compiler that has a libc for WebAssembly.

    Zig is preferred, because the package `ziglang` is complete and of a known version. Of clang it
    is unknown whether wasi-libc is installed; if not, the compilation fails with its message.

    Returns:
        First words of the command, to which flags and files are added.

    Raises:
        OscContactError: neither zig nor clang with the linker wasm-ld is installed.
    """
    if find_spec("ziglang") is not None:
        return [sys.executable, "-m", "ziglang", "cc", "-target", "wasm32-wasi"]
    if shutil.which("clang") and shutil.which("wasm-ld"):
        # clang's name of the target has no vendor; Debian installs wasi-libc below /usr
        return ["clang", f"--target={TRIPLE.replace('-unknown', '')}", "--sysroot=/usr"]
    raise OscContactError(
        f"{MODULE} is made by a C compiler for WebAssembly, and there is none here: "
        'pip install "osc-contact[web]" brings one (Debian: clang, lld, wasi-libc and '
        "libclang-rt-dev-wasm32)"
    )


def _run_command(command: Sequence[str], folder: Path, **variables: str) -> None:
    """Run a command in a folder.

    Args:
        command: words of the command.
        folder: working directory.
        **variables: environment variables in addition to those of this process.

    Raises:
        OscContactError: the command fails; with the end of its error output.
    """
    root = str(Path(__file__).resolve().parents[2])
    paths = os.pathsep.join([root, *filter(None, [os.environ.get("PYTHONPATH")])])
    result = subprocess.run(
        command,
        cwd=folder,
        env={**os.environ, "PYTHONPATH": paths, **variables},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
    )
    if result.returncode != 0:
        raise OscContactError(
            f"{MODULE} cannot be made: {' '.join(command[:4])} … ends with {result.returncode}: "
            f"{result.stderr.strip()[-800:]}"
        )


if __name__ == "__main__":  # python -m … FILE writes the module to FILE
    if len(sys.argv) == 2:
        Path(sys.argv[1]).write_bytes(law_wasm())
