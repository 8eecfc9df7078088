"""Metadata of the package: the README, with links that lead somewhere outside of the repository."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from hatchling.metadata.plugin.interface import MetadataHookInterface

_LINK = re.compile(r"(!?)\[([^\]]*)\]\((?!https?:|#)([^)]+)\)")


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
