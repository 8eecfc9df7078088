"""Hooks of the build: README links that lead somewhere outside, and the compiled law in wheels.

The law goes in where numba and a C compiler can make it.
OSC_CONTACT_LAW=jit leaves it out: such a wheel is for every platform, and the law is compiled when
it is first used. So it is where a checkout is installed with `pip install -e`.
"""

import os
import re
import sys
import sysconfig
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface
from hatchling.metadata.plugin.interface import MetadataHookInterface

_LINK = re.compile(r"(!?)\[([^\]]*)\]\((?!https?:|#)([^)]+)\)")
OLDEST = (2, 17)  # glibc of manylinux2014


class CustomBuildHook(BuildHookInterface):
    """Adds the two files of `osc_contact.law.library` and law.wasm to a wheel."""

    def dependencies(self):
        """What pip brings into the environment that a wheel is built in."""
        if os.environ.get("OSC_CONTACT_LAW") == "jit":
            return []
        core = self.metadata.core
        extras = core.optional_dependencies
        return [*core.dependencies, *extras["law"], *extras["web"]]

    def initialize(self, version, build_data):
        """Take both files in; where they cannot be made the wheel is one without them."""
        if version == "editable" or os.environ.get("OSC_CONTACT_LAW") == "jit":
            return
        sys.path.insert(0, self.root)
        try:
            from osc_contact.law import jit, library

            folder = Path(jit.the_library().__file__).parent
        except Exception as error:
            self.app.display_warning(f"wheel without the compiled law: {error}")
            return
        else:
            self._bring_web(build_data)
        finally:
            sys.path.remove(self.root)
        for name in (library.LIBRARY, library.OBJECT):
            build_data["force_include"][str(folder / name)] = f"osc_contact/law/{name}"
        build_data["pure_python"] = False
        build_data["tag"] = f"cp311-abi3-{platform_of(folder / library.LIBRARY)}"
        self.app.display_info("wheel with the compiled law")

    def _bring_web(self, build_data):
        """Take law.wasm in; where it cannot be made the wheel is one without it."""
        try:
            from osc_contact.control import web_assembly

            content = web_assembly.law_wasm()
        except Exception as error:
            self.app.display_warning(f"wheel without the law for web pages: {error}")
            return
        self._folder = TemporaryDirectory()  # until the wheel is written
        file = Path(self._folder.name) / web_assembly.MODULE
        file.write_bytes(content)
        build_data["force_include"][str(file)] = f"osc_contact/law/{file.name}"


def platform_of(library):
    """The tag of the oldest Linux that a library runs on, by the versions of glibc it names."""
    platform = re.sub(r"[.-]", "_", sysconfig.get_platform())
    if not platform.startswith("linux_"):
        return platform
    found = re.findall(rb"GLIBC_(\d+)\.(\d+)", library.read_bytes())
    fits = all((int(a), int(b)) <= OLDEST for a, b in found)
    return platform.replace("linux", "manylinux_{}_{}".format(*OLDEST)) if fits else platform


class LinkedReadme(MetadataHookInterface):
    """Makes links absolute where pyproject.toml gives the repository's address."""

    def update(self, metadata: dict[str, Any]) -> None:
        """Set readme and urls."""
        text = (Path(self.root) / "README.md").read_text(encoding="utf-8")
        address = str(self.config["address"])
        metadata["urls"] = {"Repository": address} if address else {}
        metadata["readme"] = {
            "content-type": "text/markdown",
            "text": absolute(text, address) if address else text,
        }


def absolute(text: str, address: str) -> str:
    """The page with links into the repository: raw files for pictures, pages for all else."""

    def link(found: re.Match[str]) -> str:
        kind = "raw" if found[1] else "blob"
        return f"{found[1]}[{found[2]}]({address}/{kind}/main/{found[3]})"

    return _LINK.sub(link, text)
