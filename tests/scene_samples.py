"""A small recording whose every number is known, and what its page shows."""

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
    """One second at 100 Hz: a turning arm, a rod on its way, forces rising from 0 to 12 N."""
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
    """The recording with other channels."""
    return Recording(RECORDING.meta, RECORDING.channels | channels)


CONTENT = Content("test <scene>", ARMS, BODIES, ENDS)


def write(folder, recording=RECORDING, fps=10, **how):
    """The recording's page."""
    contacts = recording.meta["contact_names"]
    content = replace(CONTENT, contacts=contacts)
    return write_scene(recording, content, folder / "scene.html", fps, **how)


def links(q):
    """Placements of the arm's links in the world, by Pinocchio alone."""
    model = pin.buildModelFromUrdf(str(URDF / "scara_left.urdf"))
    data = data_at(model, q)
    joints = ("joint1", "joint2", "joint3", "hinge")
    return {name: BASE * data.oMi[model.getJointId(name)] for name in joints}


def read_commands(page):
    """The drawing commands of a written page, in the order in which they are drawn."""
    (folded,) = re.findall(r'^unfold\("([A-Za-z0-9+/=]*)"\)', page.read_text(), re.MULTILINE)
    whole = zlib.decompress(base64.b64decode(folded))
    commands = []
    while whole:
        end = 4 + int.from_bytes(whole[:4], "little")
        commands.append(umsgpack.unpackb(whole[4:end]))
        whole = whole[end:]
    return commands


def matrix(command):
    """(4, 4) of a set_transform."""
    return np.reshape(command["matrix"], (4, 4)).T


class Shown:
    """The nodes of a page at a frame of its animation, as meshcat's viewer has them."""

    def __init__(self, page):
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
        """Commands of a type."""
        return [command for command in self.commands if command["type"] == kind]

    def at(self, path, key, frame):
        """A property of a node: its key frame, or what it was set to once."""
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
        """Placement of a node in its parent."""
        numbers = [self.at(path, key, frame) for key in ("position", "quaternion")]
        return pin.XYZQUATToSE3(np.concatenate(numbers))

    def length(self, arrow, frame):
        """From the tip of an arrow to the end of its shaft (m)."""
        shaft = f"{arrow}/shaft"
        return self.at(shaft, "scale", frame)[1] - self.at(shaft, "position", frame)[1]

    def seen(self, path, frame):
        """Whether a node and everything above it is visible."""
        parts = path.split("/")
        above = ["/".join(parts[: k + 1]) for k in range(2, len(parts))]
        return all(self.at(node, "visible", frame) for node in above)

    def path_of_tube(self, path):
        """(k, 3) middles of a tube of six sides, and the angles of the points about y."""
        data = self.objects[path]["geometries"][0]["data"]["attributes"]["position"]["array"].data
        middles = np.frombuffer(data, np.float32).reshape(-1, 6, 3).mean(axis=1)
        return (middles, np.unwrap(np.arctan2(middles[:, 0], middles[:, 2])))
