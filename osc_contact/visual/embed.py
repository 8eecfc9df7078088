"""A written page inside a notebook."""

from __future__ import annotations

import html
from dataclasses import dataclass, field
from pathlib import Path

__all__ = ["Embedded", "embed"]


@dataclass(frozen=True)
class Embedded:
    """What a notebook shows for a page; the page travels with the notebook."""

    page: str = field(repr=False)
    height: int

    def _repr_html_(self) -> str:
        return (
            f'<iframe srcdoc="{html.escape(self.page)}" loading="lazy" '
            f'style="width: 100%; height: {self.height}px; border: 0"></iframe>'
        )


def embed(path: str | Path, height: int = 640) -> Embedded:
    """Show a page of `write_scene` as the value of a notebook's cell.

    Args:
        path: the page, such as scene.html of a run.
        height: pixels.
    """
    return Embedded(Path(path).read_text(encoding="utf-8"), height)
