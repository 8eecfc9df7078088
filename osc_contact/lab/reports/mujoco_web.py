"""MuJoCo's official WebAssembly build: two files of its npm package, pinned by content."""

from __future__ import annotations

import shutil
import subprocess
import tarfile
from base64 import b64decode
from hashlib import sha512
from pathlib import Path
from tempfile import TemporaryDirectory

from osc_contact.errors import OscContactError
from osc_contact.files import write_whole
from osc_contact.law.library import cache_folder

VERSION = "3.14.0"  #: sensors feel welds as they are from here on
PACKAGE = f"@mujoco/mujoco@{VERSION}"
ARCHIVE = f"mujoco-mujoco-{VERSION}.tgz"
#: SHA-512 of the archive, as the registry gives it.
INTEGRITY = (
    "WPUYidu4Fx8+uM4hQv80SOA0ifpWGrsNJguKs8JBV8SCTxjKQ2/rqsh880nUH0/Vwa8vuefghvCQkkoed3bkUg=="
)
NAMES = ("mujoco.js", "mujoco.wasm")


def mujoco_files(archive: Path | None = None) -> dict[str, bytes]:
    """The script and the module, by their names.

    Args:
        archive: of the npm package; None: one that was kept, or npm brings it.

    Raises:
        OscContactError: there is none, or its content is another one.
    """
    content = _package_from_cache() if archive is None else _read(archive)
    with TemporaryDirectory() as folder:
        path = Path(folder) / ARCHIVE
        path.write_bytes(content)
        with tarfile.open(path) as opened:
            members = {name: opened.extractfile(f"package/{name}") for name in NAMES}
            return {name: member.read() for name, member in members.items() if member is not None}


def _read(archive: Path) -> bytes:
    """Read the npm package of MuJoCo from a file, and compare its SHA-512 with the registry's.

    Args:
        archive: archive of the npm package.

    Raises:
        OscContactError: the file is not there, or has another content.
    """
    try:
        content = archive.read_bytes()
    except OSError as error:
        raise OscContactError(f"{archive} cannot be read: {error.strerror}") from error
    if sha512(content).digest() != b64decode(INTEGRITY):
        raise OscContactError(
            f"{archive} is not the archive of {PACKAGE}: its SHA-512 differs from the registry's; "
            f"bring it by: npm pack {PACKAGE}"
        )
    return content


def _package_from_cache() -> bytes:
    """Return the npm package of MuJoCo from the user's cache; npm downloads it the first time.

    Raises:
        OscContactError: there is no npm, or it cannot download the package.
    """
    cached = cache_folder() / ARCHIVE
    if cached.is_file():
        return _read(cached)
    cure = f"where npm is: npm pack {PACKAGE}; here: --mujoco {ARCHIVE}"
    npm = shutil.which("npm")
    if npm is None:
        raise OscContactError(
            f"MuJoCo's WebAssembly build comes from npm, which is not here; {cure}"
        )
    with TemporaryDirectory() as folder:
        command = [npm, "pack", "--silent", PACKAGE]
        process = subprocess.run(command, cwd=folder, capture_output=True, text=True)
        if process.returncode != 0:
            raise OscContactError(
                f"npm cannot bring {PACKAGE} ({process.stderr.strip()[-300:]}); {cure}"
            )
        content = _read(Path(folder) / ARCHIVE)
    cached.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    write_whole(content, cached)
    return content
