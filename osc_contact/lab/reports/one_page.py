"""A page with all its files inside, which opens from disk, and licences of the software in it."""

from __future__ import annotations

import base64
import json
import re
import tarfile
import zlib
from collections.abc import Mapping
from importlib.metadata import distribution
from importlib.resources import files

from osc_contact.errors import OscContactError
from osc_contact.lab.reports.mujoco_web import PACKAGE
from osc_contact.lab.visual.page import asset, filled

_SCRIPTS = ("mujoco.js", "controller.mjs", "worker.mjs")
#: Text that only a module may contain, with its replacement in a classic script.
_OF_MODULES = (
    (r"\bimport\.meta\.url\b", "self.location.href"),
    (r"(?m)^import .*$", ""),
    (r"(?m)^export default \w+;$", ""),
    (r"(?m)^export (?=async function|function|class|const)", ""),
)


def packed_files(contents: Mapping[str, str | bytes]) -> str:
    """Make a script element that holds all files of a page and starts its worker with them.

    Args:
        contents: text of each file by name, three modules of JavaScript among them.

    Raises:
        OscContactError: a module contains a statement that no classic script may contain.
    """
    script = "\n".join(_as_classic_script(name, _as_text(contents[name])) for name in _SCRIPTS)
    inside = {name: content for name, content in contents.items() if name not in _SCRIPTS}
    packed = {
        name: base64.b64encode(zlib.compress(_as_bytes(content), 9)).decode("ascii")
        for name, content in (*inside.items(), ("worker.js", script))
    }
    return f"<script>\n{filled('web_one_file.js', {'packed': json.dumps(packed)})}</script>"


def _as_classic_script(name: str, module: str) -> str:
    """Convert a JavaScript module to a classic script, without imports and exports.

    Args:
        name: name of the file, for the message.
        module: its text.

    Raises:
        OscContactError: something of a module remains.
    """
    for pattern, replacement in _OF_MODULES:
        module = re.sub(pattern, replacement, module)
    if match := re.search(r"(?m)^(import|export) .*|import\.meta", module):
        raise OscContactError(f"{name} cannot be a classic script: it has {match[0][:60]!r}")
    return module


def _as_text(content: str | bytes) -> str:
    """Convert the content of a file to text."""
    return content if isinstance(content, str) else content.decode("utf-8")


def _as_bytes(content: str | bytes) -> bytes:
    """Convert the content of a file to bytes."""
    return content.encode("utf-8") if isinstance(content, str) else content


def licences() -> str:
    """Licences of all software in the page: MuJoCo, meshcat with its parts, DAQP and wasi-libc.

    Those of meshcat and DAQP are read from their packages. MuJoCo's package has none, so the text
    of the Apache License is packaged here, as is that of wasi-libc. Each text has a title between
    lines of "=".
    """
    own_licence = distribution("osc-contact").metadata["License-Expression"]
    viewer = files("meshcat") / "viewer"
    sources = files("osc_contact.control") / "c_files" / "daqp-0.11.0.tar.xz"
    with sources.open("rb") as stream, tarfile.open(fileobj=stream) as archive:
        licence_file = archive.extractfile("daqp/LICENSE")
        assert licence_file is not None
        daqp = licence_file.read().decode("utf-8")
    parts = {
        "osc_contact (this page, law.wasm)": own_licence,
        f"MuJoCo (mujoco.js, mujoco.wasm: {PACKAGE})": "Copyright DeepMind Technologies Limited. "
        "Apache License 2.0, whose text is the last part of this file.",
        "meshcat (in index.html)": (viewer / "LICENSE").read_text("utf-8"),
        "what meshcat contains": (viewer / "dist" / "main.min.js.LICENSE.txt").read_text("utf-8"),
        "DAQP (in law.wasm)": daqp,
        "wasi-libc (in law.wasm)": asset("wasi_libc_licence.txt"),
        "Apache License 2.0": asset("apache_licence.txt"),
    }
    line = 80 * "="
    return "\n".join(
        f"{line}\n{title}\n{line}\n\n{text.strip()}\n" for title, text in parts.items()
    )
