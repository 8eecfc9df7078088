"""robosuite's wiping pad under a constant load, dragged without any controller.

    python -m benchmarks.dragged_pad    (in the environment of make worlds for robosuite)

The geoms of the pad and of the table are those of the task `Wipe`, with its solver. The pad lies
flat and cannot rotate; its mass is the apparent mass of the arm there, along the vertical, and the
stiffness of its contacts is that behind the arm. A constant force of 12 N presses it down while a
velocity servo drags it at 50 mm/s, with a turn of 60° every second. What the contact force differs
from the load is the contact's own doing. The last column: longest time for which a corner of
`benchmarks.wiping.pad_on_table` carries less than a fifth of its third of the load.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
import typer
from rich.console import Console

from benchmarks.wiping import ARM, FORCE, SPEED, WINDOW, OscPose, Wiping, pad_on_table
from osc_contact.spatial import Array
from paper.study import table_of

FRICTION = (0.03, 0.1, 0.2, 0.3)
SERVO = 2000.0  #: gain of the velocity servo (N s/m)
DURATION, SETTLING = 6.0, 1.0  #: of a run, and what is left out of it (s)
TURN = np.radians(60.0)  #: of the path, once a second
DOWN = np.diag([1.0, -1.0, -1.0])  #: rotation of the pad, whose z axis points down
LOST = 0.2  #: share of its force below which the corner of a face is lost


def apparent_mass(model: Any, data: Any, site: int) -> float:
    """Apparent mass of the arm along the vertical at a site (kg).

    Args:
        model, data: MuJoCo's.
        site: index of the site.
    """
    J = np.zeros((3, model.nv))
    mujoco.mj_jacSite(model, data, J, None, site)
    M = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, M, data.qM)
    return float(1.0 / (J[2] @ np.linalg.solve(M, J[2])))


def pad_alone(model: Any, data: Any, site: int, mass: float, friction: float) -> Any:
    """Model of the pad on three slides above the table, its lowest points on it.

    Args:
        model, data: MuJoCo's, of the task.
        site: index of the grip site, which is the origin of the pad.
        mass: mass of the pad (kg).
        friction: coefficient of the table.
    """
    names = [model.geom(k).name for k in range(model.ngeom)]
    table = names.index("table_collision")
    touching = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    tool = [k for k, name in enumerate(names) if "gripper0" in name and touching[k]]
    spec = mujoco.MjSpec()
    for name in ("timestep", "cone", "impratio", "solver", "iterations"):
        setattr(spec.option, name, getattr(model.opt, name))
    spec.option.gravity = [0.0, 0.0, 0.0]
    pad = spec.worldbody.add_body(name="pad")
    pad.mass, pad.inertia, pad.explicitinertial = mass, [0.01 * mass] * 3, True
    for axis in np.eye(3):
        pad.add_joint(type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis)
    # the arm holds the pad at an angle at first; here it lies flat
    level = DOWN @ np.array(data.site_xmat[site]).reshape(3, 3).T
    poses = {
        k: (
            level @ data.geom_xmat[k].reshape(3, 3),
            level @ (data.geom_xpos[k] - data.site_xpos[site]),
        )
        for k in tool
    }
    lowest = min(_lowest(model, k, *pose) for k, pose in poses.items())
    for k in [table, *tool]:
        size = model.geom_size[k]
        # the table moves instead of the pad, whose origin is that of the world at first
        rotation, at = poses.get(k, (np.eye(3), np.array([0.0, 0.0, lowest - size[2]])))
        quaternion = np.zeros(4)
        mujoco.mju_mat2Quat(quaternion, rotation.ravel())
        body = spec.worldbody if k == table else pad
        geom = body.add_geom(
            type=mujoco.mjtGeom(int(model.geom_type[k])), size=size, pos=at, quat=quaternion
        )
        for name in ("friction", "condim", "solref", "solimp", "margin", "gap", "priority"):
            setattr(geom, name, getattr(model, f"geom_{name}")[k])
        if k == table:
            geom.friction[0] = friction
    alone = spec.compile()
    # MuJoCo's contacts are stiff in proportion to the mass that a body has in its first pose
    alone.body_invweight0[alone.body("pad").id] = model.body_invweight0[model.geom_bodyid[tool[0]]]
    return alone


def _lowest(model: Any, geom: int, rotation: Array, at: Array) -> float:
    """Height of the lowest point of a box or sphere (m).

    Args:
        model: MuJoCo's.
        geom: index of the shape.
        rotation, at: its pose.
    """
    size = model.geom_size[geom]
    if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_SPHERE:
        return float(at[2] - size[0])
    return float(at[2] - np.abs(rotation[2]) @ size)


def dragged(model: Any, load: float, speed: float) -> tuple[Array, Array]:
    """Normal forces of a dragged pad after it has settled (N).

    Args:
        model: MuJoCo's, of `pad_alone`.
        load: constant force downward (N).
        speed: speed along the table (m/s).

    Returns:
        Forces (steps,) in all, and at the corners of the face (steps, 3).
    """
    data = mujoco.MjData(model)
    force, pressed = np.zeros(6), []
    for k in range(round(DURATION / model.opt.timestep)):
        angle = TURN * int(data.time)
        goal = speed * np.array([np.cos(angle), np.sin(angle)])
        data.qfrc_applied[:2] = SERVO * (goal - data.qvel[:2])
        data.qfrc_applied[2] = -load
        mujoco.mj_step(model, data)
        wrench = np.zeros(6)  # on the table, at the pad's origin
        for contact in range(data.ncon):
            mujoco.mj_contactForce(model, data, contact, force)
            normal = np.array([0.0, 0.0, -force[0]])
            wrench[:3] += normal
            wrench[3:] += np.cross(data.contact.pos[contact] - data.qpos[:3], normal)
        if k * model.opt.timestep >= SETTLING:
            pressed.append(wrench)
    wrenches = np.array(pressed)
    N = pad_on_table().contact(pin.SE3(DOWN, np.zeros(3)), np.zeros(6)).N
    return -wrenches[:, 2], np.linalg.lstsq(N, wrenches.T, rcond=None)[0].T


def longest(low: Array) -> int:
    """Largest number of consecutive steps in which a corner is low, from (steps, corners)."""
    runs = np.zeros(low.shape[1], int)
    most = 0
    for row in low:
        runs = np.where(row, runs + 1, 0)
        most = max(most, int(runs.max()))
    return most


def main(load: float = FORCE) -> None:
    """Print the differences of the contact force from a constant load.

    Args:
        load: force downward (N).
    """
    task = Wiping(OscPose(75.0, 0.009), 0)
    model, data = task.env.sim.model._model, task.env.sim.data._data
    site = task.env.robots[0].eef_site_id[ARM]
    mass = apparent_mass(model, data, site)
    rows: list[list[object]] = []
    for speed in (0.0, SPEED):
        for friction in FRICTION:
            alone = pad_alone(model, data, site, mass, friction)
            forces, corners = dragged(alone, load, speed)
            smooth = np.convolve(forces, np.full(WINDOW, 1.0 / WINDOW), "valid")
            errors = [
                100.0 * float(np.sqrt(np.mean((f - load) ** 2))) / load for f in (forces, smooth)
            ]
            cells = (f"{forces.mean():.2f}", *(f"{error:.1f}" for error in errors))
            low = 1e3 * alone.opt.timestep * longest(corners < LOST * load / 3.0)
            rows.append([f"{1e3 * speed:g}", f"{friction:g}", *cells, f"{low:.0f}"])
    heads = "speed (mm/s); friction; mean force (N); rms raw (%); rms of 20 ms (%); corner low (ms)"
    title = f"pad of {mass:.1f} kg under {load:g} N, without a controller"
    Console(width=120).print(table_of(title, heads, rows))


if __name__ == "__main__":
    typer.run(main)
