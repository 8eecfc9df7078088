"""A small recording whose every number is known, and what a page of it can be asked."""

from __future__ import annotations

import base64
import re
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import umsgpack

from osc_contact.recorder import Recording
from osc_contact.visual.parts import ArmVisual, BodyVisual

URDF = Path(__file__).parents[1] / "urdf"
BASE = pin.SE3(np.eye(3), np.array([-0.35, -0.4, 0.0]))
FACE = pin.SE3(pin.rpy.rpyToMatrix(0.3, 0.4, 0.0), np.array([-0.3, 0.0, 0.19]))
ARMS = [ArmVisual("left", URDF / "scara_left.urdf", [URDF], BASE, slice(0, 5))]
BODIES = [
    BodyVisual("rod", URDF / "rod.urdf", [URDF], None),
    BodyVisual("face", URDF / "face.urdf", [URDF], FACE, face=0),
]


def make_recording(contacts: int = 2, without: tuple[str, ...] = ()) -> Recording:
    """One second at 100 Hz: a turning arm, a rod on its way, forces rising from 0 to 12 N."""
    t = np.arange(101) / 100.0
    ticks = len(t)
    q = np.column_stack([0.3 + t, -1.0 - t, 0.1 + 0.1 * t, t, 0.0 * t])
    pose = np.tile([0.0, 0.0, 0.2, 0.0, 0.0, 0.0, 1.0], (ticks, 1))
    pose[:, 1] = 0.05 * np.sin(t)
    alpha = np.column_stack([12.0 * t, 9.0 * t])[:, :contacts]
    closed = np.ones((ticks, contacts), dtype=bool)
    closed[40:60, :1] = False
    points = np.tile([[-0.3, 0.0, 0.2], [0.3, 0.0, 0.2]], (ticks, 1, 1))[:, :contacts]
    points[:, :, 1] += pose[:, 1:2]
    directions = np.tile([[-0.6, 0.0, -0.8], [0.6, -0.8, 0.0]], (ticks, 1, 1))[:, :contacts]
    channels = {
        "t": t, "q": q, "pose": pose, "tau": np.outer(t, np.arange(1.0, 5.0)),
        "alpha_cmd": alpha + 1.0, "alpha_meas": alpha + 0.1, "alpha_true": alpha,
        "closed": closed, "contact_point": points, "contact_direction": directions,
        "power_total": np.sin(20.0 * t),
        "power_projected": np.where(t < 0.5, 0.01, 2.0 * (t < 0.54)),
        "motion_error": np.outer(t, [3e-3, 0.0, 4e-3, 0.0, 5e-3, 0.0]),
    }  # fmt: skip
    names = ["left_end", "right_end"][:contacts]
    joints = [f"left/{name}" for name in ("joint1", "joint2", "joint3", "joint4", "hinge")]
    scenario = {"name": "test_<scene>", "arms": [{"name": "left", "passive_joints": ["hinge"]}]}
    meta = {
        "scenario": scenario, "contact_names": names, "arm_names": ["left"], "joint_names": joints
    }  # fmt: skip
    return Recording(meta, {k: v for k, v in channels.items() if k not in without})


def read_commands(page: Path) -> list[dict[str, Any]]:
    """The drawing commands of a written page, in the order in which they are drawn."""
    text = page.read_text(encoding="utf-8")
    (folded,) = re.findall(r'^unfold\("([A-Za-z0-9+/=]*)"\)', text, re.MULTILINE)
    whole, commands = zlib.decompress(base64.b64decode(folded)), []
    while whole:
        end = 4 + int.from_bytes(whole[:4], "little")
        commands.append(umsgpack.unpackb(whole[4:end]))
        whole = whole[end:]
    return commands


def tracks(page: Path) -> dict[str, dict[str, dict[int, Any]]]:
    """{path: {property: {frame: value}}} of the page's animation."""
    (command,) = [c for c in read_commands(page) if c["type"] == "set_animation"]
    return {
        a["path"]: {
            t["name"].lstrip("."): {k["time"]: k["value"] for k in t["keys"]}
            for t in a["clip"]["tracks"]
        }
        for a in command["animations"]
    }


class Shown:
    """Where the nodes of a page are at a frame of its animation, as meshcat's viewer has them."""

    def __init__(self, page: Path) -> None:
        self.commands, self.tracks = read_commands(page), tracks(page)

    def at(self, path: str, key: str, frame: int) -> Any:
        """A property of a node: its key frame, or what it was set to once."""
        keys = self.tracks.get(path, {}).get(key)
        if keys is not None:
            return keys[max(k for k in keys if k <= frame)]
        for command in reversed(self.commands):
            if command["path"] == path and command.get("property") == key:
                return command["value"]
            if command["path"] == path and command["type"] == "set_transform":
                matrix = np.reshape(command["matrix"], (4, 4)).T
                if key == "position":
                    return matrix[:3, 3].tolist()
                if key == "quaternion":
                    return pin.Quaternion(matrix[:3, :3]).coeffs().tolist()
        return {"visible": True, "scale": [1.0, 1.0, 1.0], "position": [0.0] * 3,
                "quaternion": [0.0, 0.0, 0.0, 1.0]}[key]  # fmt: skip

    def pose(self, path: str, frame: int) -> pin.SE3:
        """Placement of a node in its parent."""
        numbers = [self.at(path, key, frame) for key in ("position", "quaternion")]
        return pin.XYZQUATToSE3(np.concatenate(numbers))

    def seen(self, path: str, frame: int) -> bool:
        """Whether a node and everything above it is visible."""
        parts = path.split("/")
        above = ["/".join(parts[: k + 1]) for k in range(2, len(parts))]
        return all(self.at(node, "visible", frame) for node in above)
