"""The paper's figures from our own data: fig. 1, 4, 5, 6 and 8."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from osc_contact.contacts.pairs import VertexOnFace
from osc_contact.control.controller import Block
from osc_contact.errors import InvalidInputError
from osc_contact.paper.studies import STUDIES
from osc_contact.recorder import Recording
from osc_contact.runs.metrics import SETTLE_S
from osc_contact.runs.rig import Rig, build_rig
from osc_contact.scenarios import Scenario, load_scenario
from osc_contact.spatial import Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = [
    "FIGURES",
    "SCENARIO",
    "control_blocks",
    "needs_run",
    "reproduce",
    "require_known",
    "write_figure",
]

SCENARIO = "two_contact_rod"
BUSES = ("state", "contact", "environment")  #: read by nearly every box
LABELS = {
    "qv": r"$q,\ v$",
    "contact": r"$N,\ T$",
    "parts": r"$N_i$",
    "drag": r"$N_\mu - N$",
    "touched": r"$X_{WE},\ V_E$",
    "environment": r"$\Phi_e,\ b_e$",
    "wrenches": "wrist wrenches",
    "reference": r"$x_d,\ \dot x_d,\ \ddot x_d$",
    "squeeze_d": "squeeze",
    "eta_c": r"$\dot\eta_c$",
}
_LOOP = {"f_c_meas", "alpha_meas", "alpha_u"}  # signals of the force loop behind the projection


def reproduce(
    name: str, scenario: Scenario | None = None, recording: Recording | None = None
) -> Figure:
    """One figure of the paper, by name ("fig1" … ).

    Args:
        name: see `FIGURES`.
        scenario: what figs. 1, 4 and 5 show (default: `two_contact_rod`).
        recording: of a run of it; needed by figs. 6 and 8.

    Raises:
        InvalidInputError: unknown figure, or a recording is needed.
    """
    require_known([name])
    if name in needs_run:
        if recording is None:
            raise InvalidInputError(f"{name} shows a run: give a recording of {SCENARIO}")
        return needs_run[name](recording)
    return _from_rig[name](build_rig(load_scenario(SCENARIO) if scenario is None else scenario))


def require_known(names: Iterable[str]) -> None:
    """Refuse names of figures that do not exist.

    Raises:
        InvalidInputError: with the names there are.
    """
    known = (*FIGURES, *STUDIES)
    for name in names:
        if name not in known:
            raise InvalidInputError(f"no figure '{name}'; there are {', '.join(known)}")


def control_blocks(rig: Rig) -> list[Block]:
    """The boxes of fig. 4 with the signals each one really read and wrote in a tick."""
    controller = rig.controller()
    plant = rig.plant()
    measurement = plant.measure()
    blocks = controller.wiring(measurement, rig.references.at(0.0))
    names = sorted({name for b in blocks for name in b.outputs} & {"tau"})
    sensed = tuple(
        dict.fromkeys(n for b in blocks for n in b.inputs if n in ("q", "v", "wrenches"))
    )
    return [*blocks, Block("arms, object, environment", "plant", "", tuple(names), sensed)]


def _fig1(rig: Rig) -> Figure:
    from osc_contact.visual.contact_picture import draw_contact_state

    X = rig.state().X_WO
    pairs = [pair for pair in rig.pairs if isinstance(pair, VertexOnFace)]
    ends = np.array([X.act(pair.vertex) for pair in pairs])
    return draw_contact_state(
        points=np.array([pair.point_on_face(X) for pair in pairs]),
        directions=np.array([pair.direction() for pair in pairs]),
        object_segments=[ends],
        faces=[_corners(pair) for pair in pairs],
        title="Fig. 1: two contacts whose normals are skew",
    )


def _corners(pair: VertexOnFace, half: float = 0.09) -> Array:
    X = pair.face_placement()
    square: Sequence[tuple[float, float]] = ((-1, -1), (1, -1), (1, 1), (-1, 1))
    return np.array([X.act(np.array([half * a, half * b, 0.0])) for a, b in square])


def _fig4(rig: Rig) -> Figure:
    from osc_contact.visual.diagrams import draw_blocks

    blocks = _bundled(_with_force_control_as_one_box(control_blocks(rig)))
    title = "Fig. 4: decoupled force/motion control"
    return draw_blocks(blocks, title, buses=BUSES, labels=LABELS)


def _fig5(rig: Rig) -> Figure:
    from osc_contact.visual.diagrams import draw_blocks

    blocks = [b for b in control_blocks(rig) if b.group == "force"]
    title = "Fig. 5: force control in the N space"
    return draw_blocks(blocks, title, buses=BUSES, labels=LABELS)


def _with_force_control_as_one_box(blocks: Sequence[Block]) -> list[Block]:
    """What fig. 5 shows behind the projection, as one box with the wires that leave it."""
    inside = [b for b in blocks if b.group == "force" and _LOOP & set(b.inputs)]
    outside = [b for b in blocks if b not in inside]
    made = {name for b in inside for name in b.outputs}
    wanted = {name for b in outside for name in b.inputs}
    box = Block(
        "force control",
        "force",
        r"$N,\ N^{\#}$: fig. 5",
        tuple(dict.fromkeys(n for b in inside for n in b.inputs if n not in made)),
        tuple(dict.fromkeys(n for b in inside for n in b.outputs if n in wanted)),
    )
    at = outside.index(next(b for b in outside if wanted & set(box.outputs) & set(b.inputs)))
    return [*outside[:at], box, *outside[at:]]


def _bundled(blocks: Sequence[Block]) -> list[Block]:
    """q and v as one wire, if nobody reads or writes only one of them."""
    if any(len({"q", "v"} & set(names)) == 1 for b in blocks for names in (b.inputs, b.outputs)):
        return list(blocks)

    def one(names: tuple[str, ...]) -> tuple[str, ...]:
        return tuple("qv" if n == "q" else n for n in names if n != "v")

    return [replace(b, inputs=one(b.inputs), outputs=one(b.outputs)) for b in blocks]


def _fig6(recording: Recording) -> Figure:
    from osc_contact.visual.plots import power

    return power(recording, recording.meta["force_steps_s"], SETTLE_S)


def _fig8(recording: Recording) -> Figure:
    from osc_contact.visual.plots import contact_forces

    return contact_forces(recording, recording.meta["force_steps_s"], SETTLE_S)


_from_rig: dict[str, Callable[[Rig], Figure]] = {"fig1": _fig1, "fig4": _fig4, "fig5": _fig5}
needs_run: dict[str, Callable[[Recording], Figure]] = {"fig6": _fig6, "fig8": _fig8}
FIGURES: tuple[str, ...] = ("fig1", "fig4", "fig5", "fig6", "fig8")


def write_figure(
    name: str, folder: Path, scenario: Scenario | None = None, recording: Recording | None = None
) -> tuple[Path, ...]:
    """Draw one figure into a folder; returns its files: PNG, SVG, PDF."""
    from osc_contact.visual.style import PRINT, save

    return save(reproduce(name, scenario, recording), folder / name, PRINT)
