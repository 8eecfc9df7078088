"""What can be compared before a robot runs: in Python, where no scenario says what is where."""

from __future__ import annotations

from collections.abc import Iterator
from copy import copy
from typing import Any

import numpy as np
import pinocchio as pin

from osc_contact.contacts.pairs.pair import pushes_only
from osc_contact.control.reports import Status
from osc_contact.control.start_check import is_clear, judge_load
from osc_contact.dynamics.closed_chain import ClosedChain
from osc_contact.errors import PlantError
from osc_contact.plants.own_mujoco import MujocoRobot
from osc_contact.runs.contacts import feet
from osc_contact.runs.task import Rule, Task
from osc_contact.spatial import Array

__all__ = ["ROBOT_RULES", "SCENE_RULES"]

PROBE_M = 1e-3  #: m; how far before and behind a face geometry is looked for
NEAR_M = 0.02  #: m; contacts that begin further away are not compared with the scene

Values = Iterator[tuple[float, dict[str, Any]]]


def _first_tick(task: Task) -> Values:
    """A copy of the controller is given what is measured and the first reference."""
    assert task.controller is not None and task.measured is not None
    trial = copy(task.controller)
    trial.tick(task.measured, next(task.every(task.dt)))
    if trial.status is Status.HELD:
        yield 1.0, {"why": trial.reason}
    elif task.pairs and is_clear(trial.settings, trial._records):
        expected = trial.result().bias_out
        error = trial.residual_wrench() - trial.f_tare
        why = judge_load(trial.settings, error, expected)
        if why:  # a controller that has not engaged may still be tared
            yield 1.0 if trial.engaged else 0.5, {"why": why}


def _jump(task: Task) -> Values:
    first = pin.XYZQUATToSE3(task.plan.X_WD[0])
    now = task.chain.state(task.q, np.zeros(task.chain.nq)).X_WO
    yield (
        float(np.linalg.norm(first.translation - now.translation)),
        {
            "first": np.round(first.translation, 4).tolist(),
            "now": np.round(now.translation, 4).tolist(),
        },
    )


def _weights(task: Task) -> Values:
    """Torques that hold the arm, as shares of the motors' limits."""
    chain = task.chain
    bias = pin.computeGeneralizedGravity(chain.model, chain.model.createData(), task.q)
    share = np.abs(bias[chain.actuated]) / np.minimum(chain.tau_max, 1e12)
    worst = int(share.argmax())
    joint = chain.actuated[worst]
    yield (
        float(share[worst]),
        {
            "joint": chain.joint_names[joint],
            "torque": bias[joint],
            "most": chain.tau_max[worst],
            "mass": _mass(chain),
        },
    )


def _mass(chain: ClosedChain) -> float:
    """kg of all that moves."""
    held = 0.0 if chain.payload is None else chain.payload.inertia.mass
    return float(held + sum(inertia.mass for inertia in list(chain.model.inertias)[1:]))


def _pulls(task: Task) -> Values:
    for k, owner in enumerate(task.owners):
        if pushes_only(task.pairs[owner]):
            wanted = task.plan.alpha_d[:, k]
            least = int(np.argmin(wanted))
            yield -float(wanted[least]), {"name": task.force_names[k], "t": task.times[least]}


def _measured_range(task: Task) -> Values:
    for k, name in enumerate(task.force_names):
        wanted = np.abs(task.plan.alpha_d[:, k])
        most = int(np.argmax(wanted))
        yield (
            float(wanted[most]) / task.safety.force_range,
            {
                "name": name,
                "t": task.times[most],
                "force": float(wanted[most]),
                "range": task.safety.force_range,
            },
        )


ROBOT_RULES = (
    Rule(_first_tick, 0.0, 0.9, "{why}"),
    Rule(
        _jump,
        0.005,
        0.1,
        "the first reference puts the object {value:.3g} m away from where it is, at {first} m "
        "instead of {now} m; begin the motion at chain.state(q, v).X_WO",
    ),
    Rule(
        _weights,
        0.9,
        1.0,
        "to hold the arm, {joint} needs {torque:.4g} N m (or N), {value:.2g} times its limit of "
        "{most:.4g}; all that moves weighs {mass:.4g} kg: are masses in kg and lengths in m?",
    ),
    Rule(
        _pulls,
        0.0,
        0.0,
        "{name} is −{value:.3g} N at t = {t:.3g} s; this contact cannot pull: give forces ≥ 0",
    ),
    Rule(
        _measured_range,
        1.0,
        1.0,
        "{name} is {force:.4g} N at t = {t:.3g} s, and readings beyond safety.force_range = "
        "{range:.4g} N are not believed; ask for less force, or raise force_range to what the "
        "wrist sensor measures",
    ),
)


# --- a MuJoCo scene -----------------------------------------------------------------------------


def _faces(task: Task) -> Iterator[tuple[str, Array, Array, tuple[float, str]]]:
    """Of each point of contact near the tool: name, place, outward normal, what the scene says."""
    if not isinstance(task.robot, MujocoRobot):
        return
    probe = task.robot.probe()
    if not probe.pairs:
        return
    X = task.chain.state(task.q, np.zeros(task.chain.nq)).X_WO
    for pair in task.pairs:
        known = getattr(pair, "surface_point", None) is not None
        if known and pushes_only(pair) and np.abs(pair.gaps(X)).max() < NEAR_M:
            for point, inward in zip(*feet(pair, X), strict=True):
                yield pair.name, point, -inward, probe.distance(point)


def _place(task: Task) -> Values:
    for name, point, _, (away, geom) in _faces(task):
        side = "before" if away > 0.0 else "inside"
        yield (
            abs(away),
            {
                "name": name,
                "point": np.round(point, 4).tolist(),
                "where": f"{1e3 * abs(away):.3g} mm {side} the nearest geom, '{geom}'",
            },
        )


def _turn(task: Task) -> Values:
    """Angle (deg) between the believed normal and the direction in which the scene recedes."""
    probe = task.robot.probe() if isinstance(task.robot, MujocoRobot) else None
    for name, point, normal, (away, geom) in _faces(task):
        own = [getattr(pair, "normal", None) for pair in task.pairs if pair.name == name]
        plane = own[0] is not None and np.allclose(own[0], normal)
        if probe is None or abs(away) > PLACE_REFUSED:
            continue
        axes = np.eye(3)
        rise = [
            probe.distance(point + PROBE_M * e)[0] - probe.distance(point - PROBE_M * e)[0]
            for e in axes
        ]
        size = float(np.linalg.norm(rise))
        cosine = float(normal @ rise) / max(size, 1e-12)
        if not plane and cosine > 0.0:  # at edges and corners geometry recedes in many directions
            continue
        yield (
            float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))),
            {
                "name": name,
                "geom": geom,
                "normal": np.round(normal, 3).tolist(),
                "own": np.round(np.array(rise) / max(size, 1e-12), 3).tolist(),
            },
        )


def _penetration(task: Task) -> Values:
    if isinstance(task.robot, MujocoRobot):
        probe = task.robot.probe()
        if probe.pairs:
            away, geom = probe.clearance()
            yield -away, {"geom": geom}


def _tool(task: Task) -> Values:
    """Distance of the tool, less the least gap that the contacts name."""
    faces = list(_faces(task))
    if not faces or max(abs(away) for *_, (away, _) in faces) > PLACE_DOUBTFUL:
        return
    X = task.chain.state(task.q, np.zeros(task.chain.nq)).X_WO
    gap = min(float(np.min(pair.gaps(X))) for pair in task.pairs if pushes_only(pair))
    away, geom = task.robot.probe().clearance()
    yield (
        abs(away - gap),
        {
            "geom": geom,
            "gap": round(1e3 * gap, 3) + 0.0,
            "away": 1e3 * away,
        },
    )


def _touchable(task: Task) -> Values:
    if isinstance(task.robot, MujocoRobot) and task.pairs and not task.robot.probe().pairs:
        yield 1.0, {}


def _masses(task: Task) -> Values:
    if not isinstance(task.robot, MujocoRobot) or task.controller is None:
        return
    model, scene = task.controller.chain, task.robot.chain
    for what, believed, true in (
        ("all that moves", _mass(model), _mass(scene)),
        ("what the wrist carries", _carried(model), _carried(scene)),
    ):
        if true > 0.0 and believed > 0.0:
            yield float(abs(np.log(believed / true))), {
                "what": what, "believed": believed, "true": true,
            }  # fmt: skip


def _carried(chain: ClosedChain) -> float:
    held = 0.0 if chain.payload is None else chain.payload.inertia.mass
    return float(held + sum(link.inertia.mass for links in chain.outboard for link in links))


def _period(task: Task) -> Values:
    if isinstance(task.robot, MujocoRobot):
        try:
            task.robot.require_steps(task.dt)
        except PlantError as error:
            yield 1.0, {"why": str(error)}


PLACE_DOUBTFUL, PLACE_REFUSED = 0.002, 0.005  #: m

SCENE_RULES = (
    Rule(_period, 0.0, 0.0, "{why}"),
    Rule(
        _touchable,
        0.0,
        0.0,
        "there are contacts, and no geom of the tool can touch the scene: give both contype and "
        "conaffinity, and take the body of the sensor, or of the tip, for the tool",
    ),
    Rule(
        _masses,
        0.1,
        0.7,
        "{what} weighs {believed:.4g} kg to the controller and {true:.4g} kg in the scene; give "
        "the controller robot.chain, or correct masses (kg) and payload",
    ),
    Rule(
        _place,
        PLACE_DOUBTFUL,
        PLACE_REFUSED,
        "contact '{name}' is believed to touch at {point} m, and that is {where}; move the "
        "contact's face to the scene's, or the scene's geom",
    ),
    Rule(
        _turn,
        3.0,
        30.0,
        "the normal of contact '{name}', {normal} out of the face, is {value:.3g} deg away from "
        "that of '{geom}', {own}; it points out of the body, towards the tool: turn it",
    ),
    Rule(
        _penetration,
        0.002,
        0.005,
        "the tool starts {value:.3g} m inside '{geom}'; begin further away, or correct the tool's "
        "geometry and the contact's radius",
    ),
    Rule(
        _tool,
        0.002,
        0.005,
        "the tool is {away:.3g} mm away from '{geom}', and the contacts say {gap:.3g} mm; correct "
        "the contact's vertex and radius, or the tip",
    ),
)
