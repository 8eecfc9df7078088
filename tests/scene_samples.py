"""Small recording with known numbers, and a reader of the page that shows it."""

import base64
import json
import re
import zlib
from dataclasses import replace

import numpy as np
import pinocchio as pin
import umsgpack
from rigs import data_at, placed
from samples import ROOT

from osc_contact.lab.visual.parts import Content, Visual
from osc_contact.lab.visual.scene import write_scene
from osc_contact.recorder import Recording

URDF = ROOT / "urdf"
BASE = placed(-0.35, -0.4)
FACE = placed(-0.3, 0.0, 0.19, (0.3, 0.4, 0.0))
ARMS = [Visual("left", URDF / "scara_left.urdf", [URDF], BASE, slice(0, 5))]
BODIES = [
    Visual("rod", URDF / "rod.urdf", [URDF], None),
    Visual("face", URDF / "face.urdf", [URDF], FACE, face=0),
]
ENDS = ["left_end", "right_end"]


def make_recording(contacts=2, without=()):
    """Recording of 1 s at 100 Hz: an arm turns, a rod moves, forces rise from 0 to 12 N.

    Args:
        contacts: number of contacts.
        without: names of channels to leave out.
    """
    t = np.arange(101) / 100.0
    pose = np.tile([0.0, 0.0, 0.2, 0.0, 0.0, 0.0, 1.0], (101, 1))
    pose[:, 1] = 0.05 * np.sin(t)
    alpha = np.outer(t, [12.0, 9.0])[:, :contacts]
    closed = np.ones((101, contacts), dtype=bool)
    closed[40:60, :1] = False
    points = np.tile([[-0.3, 0.0, 0.2], [0.3, 0.0, 0.2]], (101, 1, 1))[:, :contacts]
    points[:, :, 1] += pose[:, 1:2]
    channels = {
        "t": t,
        "q": np.column_stack([0.3 + t, -1.0 - t, 0.1 + 0.1 * t, t, 0.0 * t]),
        "pose": pose,
        "tau": np.outer(t, np.arange(1.0, 5.0)),
        "alpha_cmd": alpha + 1.0,
        "alpha_meas": alpha + 0.1,
        "alpha_true": alpha,
        "closed": closed,
        "contact_point": points,
        "contact_direction": np.tile([[-0.6, 0, -0.8], [0.6, -0.8, 0]], (101, 1, 1))[:, :contacts],
        "power_total": np.sin(20.0 * t),
        "power_projected": np.where(t < 0.5, 0.01, 2.0 * (t < 0.54)),
        "motion_error": np.outer(t, [3e-3, 0.0, 4e-3, 0.0, 5e-3, 0.0]),
    }
    meta = {
        "scenario": {
            "name": "test_<scene>",
            "arms": [{"name": "left", "passive_joints": ["hinge"]}],
        },
        "contact_names": ENDS[:contacts],
        "arm_names": ["left"],
        "joint_names": [f"left/{n}" for n in ("joint1", "joint2", "joint3", "joint4", "hinge")],
        "effort_limits": dict.fromkeys(f"left/joint{i}" for i in (1, 2, 3, 4)),
    }
    return Recording(meta, {k: v for k, v in channels.items() if k not in without})


RECORDING = make_recording()


def changed(**channels):
    """Copy of the recording with other channels."""
    return Recording(RECORDING.meta, RECORDING.channels | channels)


CONTENT = Content("test <scene>", ARMS, BODIES, ENDS)


def write(folder, recording=RECORDING, fps=10, **how):
    """Write the page of a recording into a folder; return its path.

    Args:
        folder: folder of the page.
        recording: the recording.
        fps: frames per second.
        **how: further arguments of `write_scene`.
    """
    contacts = recording.meta["contact_names"]
    content = replace(CONTENT, contacts=contacts)
    return write_scene(recording, content, folder / "scene.html", fps, **how)


def links(q):
    """Placements of the arm's links in the world at q, by name, computed by Pinocchio only."""
    model = pin.buildModelFromUrdf(str(URDF / "scara_left.urdf"))
    data = data_at(model, q)
    joints = ("joint1", "joint2", "joint3", "hinge")
    return {name: BASE * data.oMi[model.getJointId(name)] for name in joints}


def read_commands(page):
    """Read the drawing commands of a page, in their order."""
    (folded,) = re.findall(r'^unfold\("([A-Za-z0-9+/=]*)"\)', page.read_text(), re.MULTILINE)
    whole = zlib.decompress(base64.b64decode(folded))
    commands = []
    while whole:
        end = 4 + int.from_bytes(whole[:4], "little")
        commands.append(umsgpack.unpackb(whole[4:end]))
        whole = whole[end:]
    return commands


def matrix(command):
    """Matrix (4, 4) of a command set_transform."""
    return np.reshape(command["matrix"], (4, 4)).T


class Shown:
    """Nodes of a page at the frames of its animation, as meshcat's viewer shows them."""

    def __init__(self, page):
        """Read the commands, objects, key frames and configuration of a page."""
        self.page = page
        self.commands = read_commands(page)
        self.objects = {c["path"]: c["object"] for c in self.of("set_object")}
        (self.animation,) = self.of("set_animation")
        self.tracks = {
            (a["path"], track["name"].lstrip(".")): {k["time"]: k["value"] for k in track["keys"]}
            for a in self.animation["animations"]
            for track in a["clip"]["tracks"]
        }
        (text,) = re.findall(r"^const CONFIG = (.*);$", page.read_text(), re.MULTILINE)
        self.config = json.loads(text)

    def of(self, kind):
        """List of the commands of a type."""
        return [command for command in self.commands if command["type"] == kind]

    def at(self, path, key, frame):
        """Value of a property of a node at a frame: from its key frames, or as it was set.

        Args:
            path: path of the node.
            key: name of the property.
            frame: number of the frame.
        """
        keys = self.tracks.get((path, key))
        if keys is not None:
            return keys[max(k for k in keys if k <= frame)]
        found = {"visible": True, "scale": [1.0] * 3}
        X = placed()
        for command in self.commands:
            if command["path"] == path and command["type"] == "set_transform":
                X = pin.SE3(matrix(command))
            elif command["path"] == path and "property" in command:
                found[command["property"]] = command["value"]
        numbers = pin.SE3ToXYZQUAT(X).tolist()
        return ({"position": numbers[:3], "quaternion": numbers[3:]} | found)[key]

    def pose(self, path, frame):
        """Pose of a node, given by its path, in its parent at a frame."""
        numbers = [self.at(path, key, frame) for key in ("position", "quaternion")]
        return pin.XYZQUATToSE3(np.concatenate(numbers))

    def length(self, arrow, frame):
        """Distance from the tip of an arrow to the end of its shaft at a frame (m)."""
        shaft = f"{arrow}/shaft"
        return self.at(shaft, "scale", frame)[1] - self.at(shaft, "position", frame)[1]

    def seen(self, path, frame):
        """True if a node, given by its path, and all nodes above it are visible at a frame."""
        parts = path.split("/")
        above = ["/".join(parts[: k + 1]) for k in range(2, len(parts))]
        return all(self.at(node, "visible", frame) for node in above)

    def path_of_tube(self, path):
        """Middles (k, 3) of a tube with six sides (m), and their angles (k,) about y (rad)."""
        data = self.objects[path]["geometries"][0]["data"]["attributes"]["position"]["array"].data
        middles = np.frombuffer(data, np.float32).reshape(-1, 6, 3).mean(axis=1)
        return (middles, np.unwrap(np.arctan2(middles[:, 0], middles[:, 2])))
