"""The paper's figures from our own data: fig. 1, 4, 5, 6 and 8."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from osc_contact.contacts.pairs import VertexOnFace
from osc_contact.control.controller import Block
from osc_contact.errors import InvalidInputError
from osc_contact.experiments.rig import Rig, build_rig
from osc_contact.recorder import Recording
from osc_contact.scenarios import load_scenario
from osc_contact.spatial import Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["FIGURES", "control_blocks", "needs_run", "reproduce"]

SCENARIO = "two_contact_rod"


def reproduce(name: str, recording: Recording | None = None) -> Figure:
    """One figure of the paper, by name ("fig1" … ).

    Args:
        name: see `FIGURES`.
        recording: of `two_contact_rod`; needed by figs. 6 and 8.

    Raises:
        InvalidInputError: unknown figure, or a recording is needed.
    """
    if name not in FIGURES:
        raise InvalidInputError(f"no figure '{name}'; there are {', '.join(FIGURES)}")
    if name in needs_run:
        if recording is None:
            raise InvalidInputError(f"{name} shows a run: give a recording of {SCENARIO}")
        return needs_run[name](recording)
    return _from_rig[name](build_rig(load_scenario(SCENARIO)))


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
    ends = np.array([X.act(pair.vertex) for pair in rig.pairs])
    return draw_contact_state(
        points=np.array([pair.point_on_face(X) for pair in rig.pairs]),
        directions=np.array([pair.direction() for pair in rig.pairs]),
        object_segments=[ends],
        faces=[_corners(pair) for pair in rig.pairs],
        title="Fig. 1: two contacts whose normals are skew",
    )


def _corners(pair: VertexOnFace, half: float = 0.09) -> Array:
    X = pair.face_placement()
    square: Sequence[tuple[float, float]] = ((-1, -1), (1, -1), (1, 1), (-1, 1))
    return np.array([X.act(np.array([half * a, half * b, 0.0])) for a, b in square])


def _fig4(rig: Rig) -> Figure:
    from osc_contact.visual.diagrams import draw_blocks

    return draw_blocks(control_blocks(rig), "Fig. 4: decoupled force/motion control")


def _fig5(rig: Rig) -> Figure:
    from osc_contact.visual.diagrams import draw_blocks

    blocks = [b for b in control_blocks(rig) if b.group == "force"]
    return draw_blocks(blocks, "Fig. 5: force control in the N space")


def _fig6(recording: Recording) -> Figure:
    from osc_contact.visual.plots import power

    return power(recording, recording.meta["force_steps_s"])


def _fig8(recording: Recording) -> Figure:
    from osc_contact.visual.plots import contact_forces

    return contact_forces(recording)


_from_rig: dict[str, Callable[[Rig], Figure]] = {"fig1": _fig1, "fig4": _fig4, "fig5": _fig5}
needs_run: dict[str, Callable[[Recording], Figure]] = {"fig6": _fig6, "fig8": _fig8}
FIGURES: tuple[str, ...] = ("fig1", "fig4", "fig5", "fig6", "fig8")


def write_figure(name: str, folder: Path, recording: Recording | None = None) -> Path:
    """Draw one figure into a folder as PNG and SVG; returns the PNG."""
    from osc_contact.visual.plots import save

    return save(reproduce(name, recording), folder / name)[0]
