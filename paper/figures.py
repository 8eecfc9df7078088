"""The paper's figures from our own data: fig. 1, 4, 5, 6 and 8."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from osc_contact.contacts.pairs import VertexOnFace
from osc_contact.errors import InvalidInputError
from osc_contact.recorder import Recording
from osc_contact.runs.metrics import SETTLE_S
from osc_contact.runs.rig import Rig, build_rig
from osc_contact.scenarios import Scenario, load_scenario
from osc_contact.spatial import Array
from paper.studies import STUDIES

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = [
    "FIGURES",
    "SCENARIO",
    "needs_run",
    "reproduce",
    "require_known",
    "write_figure",
]

SCENARIO = "two_contact_rod"


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


def _fig1(rig: Rig) -> Figure:
    from osc_contact.visual.contact_picture import draw_contact_state

    X = rig.state().X_WO
    pairs = [pair for pair in rig.pairs if isinstance(pair, VertexOnFace)]
    if not pairs:
        raise InvalidInputError("fig1 shows vertices on faces; the scenario has none")
    ends = np.array([X.act(pair.vertex) for pair in pairs])
    return draw_contact_state(
        points=np.array([pair.point_on_face(X) for pair in pairs]),
        directions=np.array([pair.direction() for pair in pairs]),
        rod=ends,
        faces=[_corners(pair) for pair in pairs],
        title="Fig. 1: two contacts whose normals are skew",
    )


def _corners(pair: VertexOnFace, half: float = 0.09) -> Array:
    X = pair.face_placement()
    square: Sequence[tuple[float, float]] = ((-1, -1), (1, -1), (1, 1), (-1, 1))
    return np.array([X.act(np.array([half * a, half * b, 0.0])) for a, b in square])


def _fig4(rig: Rig) -> Figure:
    from paper.diagrams import LOOP, draw_blocks

    return draw_blocks(LOOP, "Fig. 4: decoupled force/motion control")


def _fig5(rig: Rig) -> Figure:
    from paper.diagrams import LOOP, draw_blocks

    blocks = [block for block in LOOP if block.group == "force"]
    return draw_blocks(blocks, "Fig. 5: force control in the N space")


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
    """Draw one figure into a folder; returns its files: PNG, SVG, PDF.

    Args:
        name, scenario, recording: as of `reproduce`.
        folder: must exist.
    """
    from osc_contact.visual.style import PRINT, save

    return save(reproduce(name, scenario, recording), folder / name, PRINT)
