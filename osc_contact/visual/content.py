"""What a scene shows, as a value that can be handed to another process."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from osc_contact.visual.bodies import ArmVisual, BodyVisual

__all__ = ["Content", "content_from", "described"]


@dataclass(frozen=True)
class Content:
    """What a scene shows.

    Attributes:
        title: heading.
        arms: moved by the channel ``q``.
        bodies: faces, and the object, moved by ``pose``.
        contacts: names of the contacts.
        columns: which contact each column of N belongs to; empty: one column per contact.
        frame_words: what the legend says about the best single frame.
    """

    title: str
    arms: Sequence[ArmVisual]
    bodies: Sequence[BodyVisual]
    contacts: Sequence[str] = ()
    columns: Sequence[int] = ()
    frame_words: str = "best single frame (Raibert–Craig)"


def described(content: Content) -> dict[str, Any]:
    """The same as JSON-able data."""
    return {
        "title": content.title,
        "arms": [
            {
                **_files(arm),
                "base": _pose(arm.base),
                "q": _ends(arm.q_slice),
                "locked": dict(arm.locked),
            }
            for arm in content.arms
        ],
        "bodies": [
            {**_files(body), "placement": _pose(body.placement), "face": body.face}
            for body in content.bodies
        ],
        "contacts": list(content.contacts),
        "columns": list(content.columns),
        "frame_words": content.frame_words,
    }


def content_from(data: dict[str, Any]) -> Content:
    """Back from `described`."""
    arms = [
        ArmVisual(a["name"], a["urdf"], a["dirs"], _placed(a["base"]), slice(*a["q"]), a["locked"])
        for a in data["arms"]
    ]
    bodies = [
        BodyVisual(b["name"], b["urdf"], b["dirs"], _placed(b["placement"]), b["face"])
        for b in data["bodies"]
    ]
    return Content(
        data["title"], arms, bodies, data["contacts"], data["columns"], data["frame_words"]
    )


def _files(visual: ArmVisual | BodyVisual) -> dict[str, Any]:
    folders = [str(folder) for folder in visual.package_dirs]
    return {"name": visual.name, "urdf": str(visual.urdf), "dirs": folders}


def _ends(part: slice) -> list[int]:
    return [int(part.start), int(part.stop)]


def _pose(pose: pin.SE3 | None) -> list[float] | None:
    return None if pose is None else pin.SE3ToXYZQUAT(pose).tolist()


def _placed(numbers: list[float] | None) -> pin.SE3 | None:
    return None if numbers is None else pin.XYZQUATToSE3(np.array(numbers))
