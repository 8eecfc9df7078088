"""Benchmark of a tool on curved faces: errors of the contact force by friction and misplacement.

    python -m benchmarks.curved_faces

A Panda presses the ball of a peg (12 mm) with 10 N on a sphere, a cylinder and a saddle (a spline
fitted to a mesh) and slides to and fro on a path of 60 mm at 0.5 Hz, across the cylinder, the peg
turned with the normal of the face. The judge is MuJoCo with friction 0 or 0.2, which the controller
does not know, and faces that it takes to be 3 mm nearer and turned by 3 deg, to four sides. Spheres
and cylinders are MuJoCo's own. It has no saddle: there the ball touches a plane, which before each
of MuJoCo's steps is put where the exact saddle is nearest to the ball; see `TangentPlane`. Last,
two Pandas hold a rod whose ball-shaped end (10 mm) does the same on a cylinder.
"""

import tempfile
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import root

import osc_contact as osc
from osc_contact.lab.plants.mujoco import MujocoPlant
from osc_contact.lab.rig.rig import PLANTS
from osc_contact.lab.sweeps.rows import without_logged_doubts
from osc_contact.spatial import Array
from paper.study import Data

RADII = [0.1, 0.3, 1.0]
BALL = 0.012  #: m
TOP = np.array([0.5, 0.0, 0.25 - BALL])  #: where the ball touches at the start
FORCE = 10.0
CASES: dict[str, Data] = {"no friction": {}, "friction 0.2, unknown": {"plant": {"friction": 0.2}}}
for _side in (0, 90, 180, 270):
    _error = {"face_offset": "3 mm", "face_tilt": "3 deg", "face_tilt_about": f"{_side} deg"}
    CASES[f"3 mm, 3 deg, side {_side}"] = {"model_error": _error}
TWO = "rod_on_cylinder"  #: two arms
LEAN = np.deg2rad(25.0)  #: of the normal where the rod touches
_CYLINDER = '<cylinder radius="{R}" length="0.4"/>'
SHAPES = {
    "sphere": '<sphere radius="{R}"/>',
    "cylinder": _CYLINDER,
    "saddle": '<box size="1 1 0.001"/>',
    TWO: _CYLINDER,
}
PLANT = "tangent_plane"
NOSE = [0, 0, -0.15]  #: the ball's middle, in the peg
BODY = """<robot name="part"><link name="part">
<visual><geometry>{shape}</geometry></visual>
<collision><geometry>{shape}</geometry></collision></link></robot>"""


def saddle_mesh(path: Path, R: float) -> None:
    """An OBJ of z = (x² − y²) / 2R, x, y = −60 … 60 mm."""
    n = 61
    x, y = np.meshgrid(*[np.linspace(-0.06, 0.06, n)] * 2, indexing="ij")
    places = zip(x.flat, y.flat, ((x * x - y * y) / (2 * R)).flat, strict=True)
    first = [n * i + k for i in range(n - 1) for k in range(1, n)]
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in places]
    lines += [f"f {k} {k + n} {k + n + 1} {k + 1}" for k in first]
    path.write_text("\n".join(lines))


def scenario(folder: Path, face: str, R: float, changes: Data) -> osc.Scenario:
    """The task on one face, its files in a folder."""
    (folder / "part.urdf").write_text(BODY.format(shape=SHAPES[face].format(R=R)))
    contact: Data = {
        "name": "nose",
        "type": "sphere_on_surface",
        "body": "part",
        "centre": NOSE,
        "radius": BALL,
        "surface": {"type": "cylinder" if face == TWO else face, "radius": R},
    }
    wave = {"type": "sine", "amplitude": "30 mm", "frequency": "0.5 Hz", "ramp": "1 s"}
    move = {"kind": "surface", "contact": "nose", "direction": [1, 0, 0], "signals": [wave]}
    middle = TOP - [0, 0, R]
    plant = {"type": "mujoco", "step": "0.25 ms"}
    held = osc.load_scenario("dual_panda_rod" if face == TWO else "panda_dome").as_dict()
    if face == "saddle":
        saddle_mesh(folder / "saddle.obj", R)
        plant["type"] = PLANT
        middle = TOP
        contact["surface"] = {"type": "mesh", "file": "saddle.obj"}
    elif face == TWO:
        plant = held["plant"]
        contact |= {"centre": [-0.29, 0, 0], "radius": 0.01}
        outward = np.array([np.sin(LEAN), 0.0, np.cos(LEAN)])  # else the shaft would touch, too
        middle = [-0.29, 0.0, 0.4] - (R + 0.01) * outward
    turn = ["90 deg" if "cylinder" in face else 0, 0, 0]
    part = {"name": "part", "urdf": "part.urdf", "pose": {"xyz": middle.tolist(), "rpy": turn}}
    data = {key: held[key] for key in ("arms", "object", "grasps")} | {
        "name": face,
        "description": str(R),
        "environment": [part],
        "contacts": [contact],
        "force": {"nose": [{"type": "constant", "value": FORCE}]},
        "motion": [move],
        "control": {"rate": "1 kHz"},
        "plant": plant,
        "duration": 5,
    }
    for key, values in changes.items():
        data[key] = {**data.get(key, {}), **values}
    return osc.Scenario.from_dict(data, folder / "task.yaml")


class TangentPlane(MujocoPlant):
    """MujocoPlant whose one face is put, before each step, where the saddle is nearest to the ball.

    Normal, place and depth of the contact are those of the saddle, exact at the beginning of each
    of MuJoCo's steps; the plane is at rest, as the saddle is.
    """

    radius: float  #: R of z = (x² − y²) / 2R, about `TOP` (m)

    def reset(self, q: Array) -> None:
        """Start at rest at q (n,)."""
        super().reset(q)
        self._put()
        self._mj.mj_forward(self.model, self.data)

    def command(self, tau: Array, duration: float) -> None:
        """Hold the torques over the steps that fit into `duration`."""
        for _ in range(self.steps_in(duration)):
            self._put()
            super().command(tau, self._step)

    def _put(self) -> None:
        """The face, whose upper side is 0.5 mm above its origin."""
        self._mj.mj_kinematics(self.model, self.data)
        held = self.object_body
        ball = self.data.xpos[held] + self.data.xmat[held].reshape(3, 3) @ NOSE
        foot, n = foot_on_saddle(ball - TOP, self.radius)
        face = self.model.body("face0/root").id
        assert self.model.body_parentid[face] == 0
        self.model.body_pos[face] = TOP + foot - 0.0005 * n
        half = np.array([1.0 + n[2], -n[1], n[0], 0.0])  # from z to n the shortest way
        self.model.body_quat[face] = half / np.linalg.norm(half)


def foot_on_saddle(p: Array, R: float) -> tuple[Array, Array]:
    """The point (3,) of z = (x² − y²) / 2R nearest to p (3,), and the upward normal there."""

    def gradient(at: Array) -> Array:
        """Gradient (2,) of half the squared distance from p to the point above x, y."""
        x, y = at
        e = (x * x - y * y) / (2 * R) - p[2]
        return at - p[:2] + e * np.array([x, -y]) / R

    x, y = root(gradient, p[:2], tol=1e-14).x
    n = np.array([-x / R, y / R, 1.0])
    return (np.array([x, y, (x * x - y * y) / (2 * R)]), n / np.linalg.norm(n))


def tangent_plane(rig: Any, seed: int) -> TangentPlane:
    """The plant of the saddle; register it as `PLANT["saddle"]`."""
    plant: Any = PLANTS["mujoco"](rig, seed)
    plant.__class__ = TangentPlane  # which keeps nothing of its own but
    plant.radius = float(rig.scenario.description)
    return plant


@without_logged_doubts()
def judge(face: str, R: float, changes: Data, duration: float = 5.0) -> Data:
    """The verdict (`metrics`) of the task on a face.

    Args:
        face: name in `SHAPES`.
        R: radius of the face (m).
        changes: overrides of the scenario.
        duration: s.
    """
    with tempfile.TemporaryDirectory() as folder:
        return osc.metrics(osc.run(scenario(Path(folder), face, R, changes), duration=duration))


def main() -> None:
    """Print the table."""
    osc.register_plant(PLANT)(tangent_plane)
    print(f"{'face':16}{'radius':>8}  {'case':24}force error, rms  closed  path, rms")
    for face, R, case in product(SHAPES, RADII, CASES):
        verdict = judge(face, R, CASES[case])
        print(
            f"{face:16}{R:6.1f} m  {case:24}{verdict['force']['nose']['rms_error_rel']:14.4%}"
            f"{verdict['contact_fraction']['nose']:9.1%}"
            f"{1e3 * verdict['motion']['rms_error_m']:8.3f} mm",
            flush=True,
        )


if __name__ == "__main__":
    main()
