"""Web page with a task: plant and law run in the browser, from files that any host can serve.

The plant is MuJoCo's official WebAssembly build, the law is law.wasm, the picture is the scene of
the live view. References are sampled into a table that the page plays. Features of a scenario that
Python computes in every step are refused.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from osc_contact.contacts.feet import feet
from osc_contact.control.saving import controller_bytes
from osc_contact.control.status import SafetyState, Status
from osc_contact.control.web_assembly import MODULE, law_wasm
from osc_contact.errors import InvalidInputError
from osc_contact.files import Json, write_whole
from osc_contact.lab.checks.preflight import require_ready
from osc_contact.lab.plants.mujoco import MujocoPlant
from osc_contact.lab.reports.mujoco_web import mujoco_files
from osc_contact.lab.reports.one_page import licences, packed_files
from osc_contact.lab.reports.viewing import content_of
from osc_contact.lab.rig.contacts import environment_bodies, rails
from osc_contact.lab.rig.references import require_known_times
from osc_contact.lab.rig.rig import Rig, build_rig
from osc_contact.lab.runs.run import run
from osc_contact.lab.scenarios.schema import Scenario
from osc_contact.lab.visual.marks import (
    HEAD_LENGTH,
    METRES_PER_NEWTON,
    METRES_PER_NEWTON_METRE,
)
from osc_contact.lab.visual.page import Around, CommandSink, asset, filled, page_text
from osc_contact.lab.visual.parts import changes
from osc_contact.lab.visual.scene import Scene, samples_at
from osc_contact.spatial import Array, cross, norm

POLICY = (
    "default-src 'none'; script-src 'unsafe-inline' 'self' 'wasm-unsafe-eval' 'unsafe-eval'; "
    "style-src 'unsafe-inline'; img-src data: blob:; worker-src 'self' blob:; "
    "connect-src 'self' data: blob:"
)
BEGIN = """<script>
window.early = [];
window.task = new Worker("worker.mjs", { type: "module" });
window.task.onmessage = (message) => window.early.push(message);
window.task.postMessage({ kind: "open", files: null });
</script>"""
PUSH = 20.0  #: largest force by the pointer (N)
SAMPLES = 100.0  #: rate of the samples of curves (1/s)
WINDOW = 10.0  #: duration that curves show (s)
Selection = dict[str, Any]  #: entries point_m, force_axes, couple_axes of a selection law
TICKS = 60_000  #: largest number of rows of the table of references
_LARGEST_WHOLE_NUMBER = 2**27  #: largest number of a column of the table, in the column's unit
_POWER_CHANNELS = ("power_total", "power_projected")  #: channels that a page does not compute


class Hindrance(NamedTuple):
    """Feature of a scenario that Python computes in every step, so that a page cannot have it.

    Attributes:
        name: name of the feature in `without`.
        words: name of the feature in messages.
        found: function that returns whether a scenario has the feature.
        left_out: function that returns keys of the scenario without the feature; None: it cannot be
            left out.
    """

    name: str
    words: str
    found: Callable[[Scenario], bool]
    left_out: Callable[[Scenario], Json] | None


def _plant_without(key: str, value: Any) -> Callable[[Scenario], Json]:
    """Make the function that replaces a key of a scenario's plant.

    Args:
        key: key of `plant`.
        value: value that leaves the feature out.
    """
    return lambda scenario: {"plant": {**dict(scenario.plant), key: value}}


def _has_moving_bodies(scenario: Scenario) -> bool:
    """Return whether a body of the environment is driven or moves on a rail."""
    return any(rail.joints for rail in rails(environment_bodies(scenario)))


HINDRANCES = (
    Hindrance("tare", "a tare", lambda s: s.tare is not None, lambda s: {"tare": None}),
    Hindrance(
        "noise", "errors of sensors", lambda s: not s.sensors.ideal, lambda s: {"sensors": {}}
    ),
    Hindrance(
        "motors",
        "errors of motors",
        lambda s: s.plant.motors is not None,
        _plant_without("motors", None),
    ),
    Hindrance("pushes", "pushes", lambda s: bool(s.plant.pushes), _plant_without("pushes", ())),
    Hindrance(
        "springs",
        "flexible joints",
        lambda s: s.plant.flexible_joints is not None,
        _plant_without("flexible_joints", None),
    ),
    Hindrance(
        "torque loop", "a joint torque loop", lambda s: s.control.joint_torque is not None, None
    ),
    Hindrance("active", "active sets of contacts", lambda s: bool(s.active), None),
    Hindrance("bodies", "bodies that move", _has_moving_bodies, None),
    Hindrance("laws", "laws in Python", lambda s: s.laws is not None, None),
    Hindrance("plant", "a plant other than MuJoCo's", lambda s: s.plant.type != "mujoco", None),
)


def playable(scenario: Scenario, without: Collection[str] = ()) -> Scenario:
    """Leave features out of a scenario, and refuse one with features that a page cannot have.

    Args:
        scenario: scenario to play.
        without: names of features in `HINDRANCES` to be left out.

    Raises:
        InvalidInputError: an unknown name, or a further feature that a page cannot have.
    """
    optional = [feature.name for feature in HINDRANCES if feature.left_out is not None]
    if unknown := sorted(set(without) - set(optional)):
        raise InvalidInputError(
            f"--without {','.join(unknown)} names nothing that can be left out: give some of "
            f"{', '.join(optional)}"
        )
    for feature in HINDRANCES:
        if feature.found(scenario) and feature.name in without and feature.left_out is not None:
            scenario = scenario.replaced(**feature.left_out(scenario))
    present = [feature for feature in HINDRANCES if feature.found(scenario)]
    if present:
        cure = ",".join(feature.name for feature in present if feature.left_out is not None)
        raise InvalidInputError(
            f"{scenario.name} has {', '.join(feature.words for feature in present)}, which Python "
            "computes step by step and a page cannot"
            + (f"; --without {cure} leaves that out" if cure else "")
        )
    return scenario


def write_web_page(
    scenario: Scenario,
    folder: Path,
    without: Collection[str] = (),
    mujoco: Path | None = None,
    select: Callable[[Rig], Selection] | None = None,
    one_file: bool = False,
) -> dict[str, int]:
    """Write the page index.html and all its files into a folder.

    Args:
        scenario: scenario to play.
        folder: folder of the files, which is created.
        without: names of features of the scenario to be left out.
        mujoco: archive of MuJoCo's npm package; None: it is taken from a cache, or fetched by npm.
        select: function that makes the selection law with which the page compares; None: none.
        one_file: True: index.html contains all other files, and can be opened from disk.

    Returns:
        Size of each file (bytes), by its name.

    Raises:
        InvalidInputError: the scenario has a feature that a page cannot have.
        OscContactError: law.wasm or the WebAssembly build of MuJoCo is missing.
    """
    scenario = playable(scenario, without)
    rig = build_rig(scenario)
    require_ready(rig)
    controller = rig.controller()
    # the page steps a plant with coarser steps, but controls with the scenario's own controller
    plant = _rig_with_friction(scenario).plant()
    assert isinstance(plant, MujocoPlant) and plant.spec is not None
    selection = None if select is None else select(rig)
    drawing = _Drawn(rig, plant, selection is not None)
    columns, table = folded(_reference_rows(rig))
    task = _worker_data(rig, plant, columns) | {"nodes": drawing.bodies, "selection": selection}
    contents: dict[str, str | bytes] = {
        "task.json": json.dumps(task, allow_nan=False),
        "worker.mjs": asset("web_worker.mjs"),
        "controller.mjs": (files("osc_contact.control") / "web_files" / "controller.mjs").read_text(
            encoding="utf-8"
        ),
        MODULE: law_wasm(),
        "plant.xml": plant.spec.to_xml(),
        "controller.osc": controller_bytes(controller),
        "references.bin": table,
        **mujoco_files(mujoco),
    }
    if one_file:
        begin, where = packed_files(contents), "at the end of this file"
        page = drawing.page(without, begin, f"Licences: {where}.")
        contents = {"index.html": page + f"<!--\n{licences()}\n-->\n"}
    else:
        contents["licences.txt"] = licences()
        contents["index.html"] = drawing.page(
            without, BEGIN, '<a href="licences.txt">Licences</a> of what runs here.'
        )
    folder.mkdir(parents=True, exist_ok=True)
    for name, content in contents.items():
        write_whole(content, folder / name)
    return {name: (folder / name).stat().st_size for name in contents}


def _rig_with_friction(scenario: Scenario) -> Rig:
    """Make a rig with friction between object and faces, whose coefficient the page can set."""
    if scenario.plant.friction > 0.0:
        return build_rig(scenario)
    return build_rig(scenario.replaced(plant={**dict(scenario.plant), "friction": 0.1}))


# --- Data of the worker ------------------------------------------------------------------------


def _reference_rows(rig: Rig) -> Array:
    """References of all ticks (ticks, 28 + forces).

    Each row has X_WD (4×4 by rows), V_D, A_D and the desired forces.

    Args:
        rig: rig of the scenario.

    Raises:
        InvalidInputError: the task is too long for a page.
        ScenarioError: the scenario has a plan.
    """
    require_known_times(rig.scenario, "a page")
    period = 1.0 / rig.scenario.control.rate
    ticks = round(rig.scenario.duration / period)
    if ticks > TICKS:
        raise InvalidInputError(
            f"{rig.scenario.name} has {ticks} ticks, and a page holds references of {TICKS}: give "
            "--set duration=… s, or a lower control.rate"
        )
    plan = rig.references.over(np.arange(ticks) * period)
    poses = [pin.XYZQUATToSE3(X).homogeneous.ravel() for X in plan.X_WD]
    return np.column_stack((np.array(poses), plan.V_D, plan.A_D, plan.alpha_d))


def folded(table: Array) -> tuple[Json, bytes]:
    """Convert a table to third differences of whole numbers, which compress well.

    Columns that do not change are left out.

    Args:
        table: (ticks, columns) numbers.

    Returns:
        Number of ticks, first row, and index and unit of each changing column; then whole numbers
        of 32 bits as bytes, column by column.
    """
    changing = [k for k in range(table.shape[1]) if np.ptp(table[:, k]) > 0.0]
    columns, parts = [], []
    for k in changing:
        unit = float(np.abs(table[:, k]).max()) / _LARGEST_WHOLE_NUMBER
        integers = np.rint(table[:, k] / unit).astype(np.int64)
        for _ in range(3):
            integers = np.diff(integers, prepend=0)
        columns.append({"index": k, "unit": unit})
        parts.append(integers.astype("<i4").tobytes())
    about = {"ticks": len(table), "constant": table[0].tolist(), "columns": columns}
    return about, b"".join(parts)


def _worker_data(rig: Rig, plant: MujocoPlant, references: Json) -> Json:
    """Data for the page's worker beyond the other files, for JSON.

    They are the control period (s) and its steps, the start (MuJoCo's positions), places of the
    joints' positions, velocities and sensor readings in MuJoCo's arrays (−6 …: no sensor) with
    torque limits, friction and softness of contacts, squeeze (N), references, numbers of signals,
    forces and walls.

    Args:
        rig: rig of the scenario.
        plant: its plant at the start.
        references: result of `folded`.
    """
    model = plant.model
    names = rig.chain.joint_names
    joints = [model.joint(name) for name in names]
    arms_with_sensors = {arm.name for arm in rig.chain.arms if arm.wrist_sensor is not None}
    first = [
        int(model.sensor(f"{arm.name}/force").adr[0]) if arm.name in arms_with_sensors else -6
        for arm in rig.chain.arms
    ]
    rate = rig.scenario.control.rate
    chain = rig.model
    # the geom of a face has priority, so that contacts without friction take all from it
    face = int(np.argmax(model.geom_priority))
    limits = np.zeros(len(names))
    limits[rig.chain.actuated] = np.where(np.isfinite(rig.chain.tau_max), rig.chain.tau_max, 0.0)
    bars = len(chain.arms) * (len(chain.arms) - 1) // 2
    return {
        "period": 1.0 / rate,
        "steps": plant.steps_in(1.0 / rate),
        "start": plant.data.qpos.tolist(),
        "object": model.body(plant.object_body).name,
        "places": {
            "positions": [int(joint.qposadr[0]) for joint in joints],
            "velocities": [int(joint.dofadr[0]) for joint in joints],
            "sensors": [at + i for at in first for i in range(6)],
            "limits": limits.tolist(),
        },
        "friction": rig.scenario.plant.friction,
        "smooth": {
            "solref": model.geom_solref[face].tolist(),
            "solimp": model.geom_solimp[face].tolist(),
        },
        "squeeze": rig.scenario.squeeze if bars else 0.0,
        "thinned": max(1, round(rate / SAMPLES)),
        "references": references | {"start": rig.references.X_start.translation.tolist()},
        "sizes": {
            "q": chain.nq,
            "wrenches": 6 * len(chain.arms),
            "torques": len(chain.actuated),
            "forces": len(rig.owners),
        },
        "forces": [
            {"name": force["name"], "wall": force["wall"]} for force in _force_descriptions(rig)
        ],
        "walls": _wall_descriptions(rig, plant),
    }


def _force_descriptions(rig: Rig) -> list[Json]:
    """Description of each force for the page's controls and plots.

    It has the name, the first and the largest command of the slider, its step and unit, and the
    index of the body that is touched. The key `wall` is −1 if several forces act on the body, so
    that MuJoCo does not give the true magnitude of this one.

    Args:
        rig: rig of the scenario.
    """
    owners, touched_bodies = rig.owners.tolist(), rig.on
    commands = rig.references.overview[1].alpha_d
    couples = _are_couples(rig)
    forces = []
    for column, (name, owner) in enumerate(zip(rig.force_names, owners, strict=True)):
        wall = touched_bodies[owner]
        alone = owners.count(owner) == 1 and touched_bodies.count(wall) == 1
        largest = float(np.abs(commands[:, column]).max())
        forces.append(
            {
                "name": name.replace("_", " "),
                "mean": float(commands[0, column]),
                "most": float(np.ceil(max(3.0 * largest, 1.0 if couples[column] else 10.0))),
                "step": 0.05 if couples[column] else 0.5,
                "unitName": "N m" if couples[column] else "N",
                "wall": wall if alone else -1,
                "turnsWith": wall,
            }
        )
    return forces


def _are_couples(rig: Rig) -> list[bool]:
    """Flag of each column of N: True for a couple, which has no force."""
    return [bool(norm(column[:3]) < 1e-9) for column in rig.contact.N.T]


def _wall_descriptions(rig: Rig, plant: MujocoPlant) -> list[Json]:
    """Description of each body of the environment: name, a touched point, and axes of its motion.

    The axes are the outward normal and a horizontal axis along the face; all are in the world.

    Args:
        rig: rig of the scenario.
        plant: plant with the names of MuJoCo's bodies.
    """
    walls = []
    N = rig.contact.N
    for i, body in enumerate(rig.bodies):
        owner = body.contacts[0]
        push = N[:3, rig.owners.tolist().index(owner)]
        normal = -push / norm(push) if norm(push) > 0.0 else np.array([0.0, 0.0, 1.0])
        axis = cross(normal, np.array([0.0, 0.0, 1.0]))
        if norm(axis) < 0.1:
            axis = np.array([1.0, 0.0, 0.0])
        point = feet(rig.pairs[owner], rig.state.X_WO)[0][0]
        walls.append(
            {
                "name": body.name.replace("_", " "),
                "body": plant.model.body(f"face{i}/root").name,
                "point": np.asarray(point).tolist(),
                "axis": (axis / norm(axis)).tolist(),
                "normal": normal.tolist(),
            }
        )
    return walls


# --- The page -------------------------------------------------------------------------------------


class _Drawn:
    """Scene at the start, with the body of MuJoCo that each moving node is fixed to.

    Attributes:
        bodies: {"body": name} for each node that moves with a body of MuJoCo; nodes at rest, and
            those that move otherwise, such as the axes of twists, have no entry.
    """

    def __init__(self, rig: Rig, plant: MujocoPlant, compares: bool) -> None:
        """Draw the scene of a rig at its start.

        Args:
            rig: rig of the scenario.
            plant: its plant.
            compares: True: plots have curves of a selection law, too.
        """
        self._compares = compares  #: whether plots have curves of a selection law, too
        self._rig = rig  #: rig of the scenario
        self._plant = plant  #: plant of the scene
        # channels at the start: the first tick of a run of two
        first = samples_at(
            run(rig.scenario, duration=2.0 / rig.scenario.control.rate).channels, slice(1)
        )
        self._force_descriptions = _force_descriptions(rig)  #: descriptions of the forces
        # true forces are known only if a wall of the plant measures them
        unknown = (
            () if any(force["wall"] >= 0 for force in self._force_descriptions) else ("alpha_true",)
        )
        channels = {
            name: value for name, value in first.items() if name not in (*_POWER_CHANNELS, *unknown)
        }
        self._scene = Scene(content_of(rig), channels)  #: scene that is drawn
        self._page_commands = CommandSink()  #: commands that draw the scene in the page
        top = self._page_commands.visualizer()
        self._scene.draw(top)
        #: state of each moving node at the start, by path
        self._node_states = self._scene.states(channels)
        changes(top, {}, self._node_states)
        # axes of twists are drawn, but hidden until the user shows them
        for path in self._node_states:
            if path.startswith("twists/") and path.count("/") == 1:
                top[path].set_property("visible", False)
        self._cameras = self._scene.look(top, channels)  #: view of the scene
        #: descriptions of the nodes that are fixed to a body
        self._nodes = [
            self._describe_node(path) for path in self._node_states if self._body_of_node(path)
        ]
        self.bodies = [{"body": node["body"]} for node in self._nodes]

    def _body_of_node(self, path: str) -> str:
        """Name of the body of MuJoCo that a node moves with; empty if there is none.

        Nodes that move with bodies are bodies/NAME/base of the object and of each body, which
        MuJoCo names object and face0, face1, …, and arms/ARM/JOINT of links, whose body is that of
        the joint ARM/JOINT. Nodes at rest and all others, such as the axes of twists, have none.

        Args:
            path: path of the node in the scene.
        """
        folder, *parts = path.split("/")
        if folder == "bodies" and parts[-1] == "base":
            names = [body.name for body in self._rig.bodies]
            return "object/root" if parts[0] == "object" else f"face{names.index(parts[0])}/root"
        if folder == "arms" and parts[-1] != "base":
            model = self._plant.model
            joint = f"{parts[0]}/{parts[1]}"
            if joint in self._rig.chain.joint_names:
                return str(model.body(int(model.joint(joint).bodyid[0])).name)
        return ""

    def _describe_node(self, path: str) -> Json:
        """Description of a moving node: path, body, and pose in the body's frame (4×4 by rows)."""
        name = self._body_of_node(path)
        body = self._plant.data.body(name)
        X_WB = pin.SE3(body.xmat.reshape(3, 3).copy(), body.xpos.copy())
        poses = self._node_states[path].poses
        assert poses is not None
        X_WN = pin.XYZQUATToSE3(poses[0])
        return {
            "path": path,
            "body": name,
            "object": name == "object/root",
            "offset": X_WB.actInv(X_WN).homogeneous.ravel().tolist(),
        }

    def _describe_forces(self) -> list[Json]:
        """Descriptions of all forces for the page's script, each with the place of its arrows.

        Returns:
            For each force the keys of its description in `_force_descriptions`; path of its node in
            the scene; point of its foot in the object's frame (m); rotation of its arrows at the
            start in the world (4×4 by rows); names of its arrows; unit (m per N or N m).
        """
        place = next(node for node in self._nodes if node["object"])  # node of the object
        marks = []
        for force, about in zip(self._scene.forces, self._force_descriptions, strict=True):
            poses = self._node_states[force.path].poses
            assert poses is not None
            X_WN = pin.XYZQUATToSE3(poses[0])
            base = self._node_states[place["path"]].poses
            assert base is not None
            rotation = pin.SE3(X_WN.rotation, np.zeros(3)).homogeneous
            marks.append(
                about
                | {
                    "path": force.path,
                    "point": pin.XYZQUATToSE3(base[0]).actInv(X_WN).translation.tolist(),
                    "rotation": rotation.ravel().tolist(),
                    "arrows": [arrow.name for arrow in force.arrows],
                    "unit": METRES_PER_NEWTON_METRE if force.couple else METRES_PER_NEWTON,
                }
            )
        return marks

    def page(self, without: Collection[str], begin: str, licences: str) -> str:
        """Text of index.html.

        Args:
            without: names of features that were left out of the task.
            begin: HTML that starts the worker.
            licences: HTML with a reference to the licences.
        """
        rig = self._rig
        keys = {
            "alpha_cmd": "commanded",
            "alpha_true": "true",
            "alpha_meas": "measured",
        }
        # data of the page's script
        self._add_errors()
        plan = rig.references.overview[1]
        task = {
            "nodes": self._nodes,
            "forces": self._describe_forces(),
            "walls": _wall_descriptions(rig, self._plant),
            "lines": [
                {"key": keys.get(line["key"], line["key"]), "index": line["index"]}
                for line in self._scene.lines
            ],
            "moves": bool(np.ptp(plan.X_WD, axis=0).max() > 0.0),
            "slides": bool(
                np.ptp(plan.X_WD[:, :3], axis=0).max() > 0.0
                and np.ptp(plan.X_WD[:, 3:], axis=0).max() == 0.0
            ),
            "head": HEAD_LENGTH,
            "push": PUSH,
            "friction": rig.scenario.plant.friction,
            "compares": self._compares,
            "states": {state.value: state.name for state in SafetyState},
            "statuses": {status.value: status.name for status in Status},
        }
        config = self._scene.config(
            live=True,
            window=WINDOW,
            curves={"t": [], "y": [[] for _ in self._scene.lines]},
            cameras=self._cameras,
            task=task,
        )
        # marks that only recordings have are not in the page's legend and labels
        for part, key in (("legend", "paths"), ("labels", "path")):
            config[part] = [entry for entry in config[part] if not _is_of_recordings(entry[key])]
        words = "Plant and law run in this browser. The law does not know of what you do to a wall."
        if without:
            words += f" Left out of this task: {', '.join(sorted(without))}."
        around = Around(
            script="web.js",
            style="web.css",
            panel=filled("web.html", {"words": words, "licences": licences}),
            head=begin,
            policy=POLICY,
        )
        title = rig.scenario.name.replace("_", " ")
        return page_text(self._page_commands, title, config, around)

    def _add_errors(self) -> None:
        """Add a plot of the errors of the forces, with dotted lines for the selection law."""
        forces = [line for line in self._scene.lines if line["key"] == "alpha_cmd"]
        looks = {"error": "solid"} | ({"selection": "dotted"} if self._compares else {})
        self._scene.panels.append(
            {
                "title": "error of the force",
                "unit": "mN",
                "note": "from 0.5 s after a change on"
                + ("; dotted: the selection law" if self._compares else ""),
                "lines": [
                    line | {"key": key, "look": look, "name": ""}
                    for key, look in looks.items()
                    for line in forces
                ],
            }
        )
        self._scene.lines = [line for panel in self._scene.panels for line in panel["lines"]]


def _is_of_recordings(paths: str | Sequence[str]) -> bool:
    """Return whether nodes are marks that a page does not compute: permitted motions, or trails.

    Args:
        paths: path of a node, or of several.
    """
    first = [paths] if isinstance(paths, str) else paths
    return any(path.split("/")[0] in ("twists", "trails") for path in first)
