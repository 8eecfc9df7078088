"""One thing that is wrong with a task, or doubtful, before it runs."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["Finding"]


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong, or doubtful.

    Attributes:
        refused: whether it cannot run; else it is doubtful.
        text: a sentence with the numbers and the cure.
    """

    refused: bool
    text: str
