"""The paper's figures from our own data, figs. 1, 4, 5, 6 and 8, and what they answer to the
statements about them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

import osc_contact as osc
from osc_contact.contacts.pairs.pair import triad
from osc_contact.contacts.raibert_craig import as_raibert_craig
from osc_contact.lab.visual import plots
from osc_contact.lab.visual.screws import common_perpendicular
from osc_contact.recorder.judged import SETTLE_S, judged_ticks
from osc_contact.spatial import Array
from paper.contact_pictures import FACE, draw_force, draw_line, scale_equally
from paper.diagrams import BLOCKS, LOOP, draw_blocks
from paper.statements import Answer

SCENARIO = "two_contact_rod"
ROD = 0.6  #: m, its length: moments count per rod length
NEED_RUN = {"fig6", "fig8"}


def reproduce(
    name: str, scenario: osc.Scenario | None = None, recording: osc.Recording | None = None
) -> Figure:
    """One figure of the paper, by name ("fig1" … ).

    Args:
        name: see `FIGURES`.
        scenario: what fig. 1 shows (default: `two_contact_rod`).
        recording: recording of a run of it; needed by figs. 6 and 8.

    Raises:
        InvalidInputError: a recording is needed.
    """
    if name == "fig1":
        return _draw_fig1(osc.build_rig(scenario or osc.load_scenario(SCENARIO)))
    if name == "fig4":
        return draw_blocks(LOOP, "Fig. 4: decoupled force/motion control")
    if name == "fig5":
        force = [block for block in LOOP if block.group == "force"]
        return draw_blocks(force, "Fig. 5: force control in the N space")
    if recording is None:
        raise osc.InvalidInputError(f"{name} shows a run: give a recording of {SCENARIO}")
    forces, power = judged_ticks(recording)
    if name == "fig6":
        return plots.power(recording, power)
    return plots.contact_forces(recording, forces)


def _faces(rig: osc.Rig) -> tuple[list[osc.VertexOnFace], Array, Array]:
    """Vertices on faces, where they touch and along which directions they push, (k, 3)."""
    X = rig.state.X_WO
    pairs = [pair for pair in rig.pairs if isinstance(pair, osc.VertexOnFace)]
    points = np.array([pair.points_of_contact(X)[:, 0] for pair in pairs])
    return pairs, points, np.array([-pair.normal for pair in pairs])


def _draw_fig1(rig: osc.Rig) -> Figure:
    """Rod, faces and lines of force, and the shortest connection of these lines."""
    pairs, points, directions = _faces(rig)
    if len(pairs) != 2:
        raise osc.InvalidInputError(f"fig1 shows two vertices on faces; there are {len(pairs)}")
    apart = common_perpendicular(points[0], directions[0], points[1], directions[1])
    with plots.style():
        figure = Figure(figsize=(7.2, 5.8))
        ax: Any = figure.add_subplot(projection="3d", proj_type="ortho")
        ax.computed_zorder = False
        ax.set(xlabel="x (m)", ylabel="y (m)", zlabel="z (m)")
        ax.locator_params(nbins=5)
        square = 0.09 * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
        for pair in pairs:
            face = pair.point + square @ triad(pair.normal).T
            ax.add_collection3d(Poly3DCollection([face], **FACE))
        rod = [rig.state.X_WO.act(pair.vertex) for pair in pairs]
        draw_line(ax, rod, color="#4A4F57", lw=5.0, label="body")
        for i, (point, direction) in enumerate(zip(points, directions, strict=True)):
            draw_force(ax, i, point, 0.11 * direction, (-6.4, 2.8), -1.5)
        words = f"{1e3 * apart.distance:.1f} mm apart, angle {np.rad2deg(apart.angle):.1f}°"
        draw_line(ax, apart[:2], color="black", ls=":", marker="o", ms=4.0, label=words)
        scale_equally(ax, 0.98)
        figure.suptitle("Fig. 1: two contacts whose normals are skew")
        figure.legend(loc="upper right", bbox_to_anchor=(0.99, 0.95))
    return figure


LOOKS = 21  #: moments of a run at which its constraint frame is looked for


@dataclass(frozen=True)
class Evidence:
    """Basis of the answers to the paper's statements.

    Attributes:
        rig: rig of the task.
        recording: recording of a run.
    """

    rig: osc.Rig
    recording: osc.Recording

    @property
    def verdict(self) -> dict[str, Any]:
        """`metrics` of the run."""
        return osc.metrics(self.recording)

    def __getitem__(self, channel: str) -> Array:
        """A channel of the run from the time on from which it is judged."""
        return self.recording[channel][self.recording["t"] >= SETTLE_S - 1e-9]


def _fig1(seen: Evidence) -> dict[str, Answer]:
    contact = seen.rig.contact
    X = seen.rig.state.X_WO
    pairs, points, directions = _faces(seen.rig)
    if len(pairs) != 2:
        return {}
    apart = common_perpendicular(points[0], directions[0], points[1], directions[1])
    angle = np.rad2deg(apart.angle)
    frame = contact.as_raibert_craig(ROD)
    arms = points - X.translation
    by_hand = np.hstack((directions, np.cross(arms, directions))).T
    off = np.abs(contact.N - by_hand).max()
    return {
        "skew": Answer(
            f"They are {angle:.1f}° and {1e3 * apart.distance:.1f} mm apart.",
            angle > 1.0 and apart.distance > 1e-3,
        ),
        "frame": Answer(
            f"No frame: {frame.reason}. The nearest one is "
            f"{np.rad2deg(np.arcsin(frame.residual)):.1f}° off N (moments per rod length).",
            not frame,
        ),
        "inspection": Answer(
            f"N of the contact model and [d; (p − O) × d] of both contacts differ by {off:.1e}.",
            bool(off < 1e-12),
            "less than 1e-12",
        ),
    }


def _fig4(seen: Evidence) -> dict[str, Answer]:
    made_by = {signal: block for block in BLOCKS for signal in block.outputs}
    structure = made_by["f_S"]
    model = made_by["contact"]
    raw = [b.name for b in BLOCKS if "a_u" in b.inputs]
    path = np.ptp(seen["contact_point"], axis=0)
    change = 1e3 * np.abs(np.ptp(seen["N"], axis=0)[3:]).max()
    return {
        "filters": Answer(
            f"As wired in a tick: the motion command enters the {raw[0]} only; "
            f"the {structure.name} reads the state and what the filters let through.",
            set(structure.inputs) == {"state", "eta_c", "f_ccomm"} and raw == ["motion filter"],
        ),
        "update": Answer(
            f"The {model.name} reads the state in every tick. In the run the contact points "
            f"travelled {1e3 * np.linalg.norm(path, axis=1).max():.0f} mm over their faces and the "
            f"moments in N (6×{seen['N'].shape[2]}, about the rod's own origin) changed by up to "
            f"{change:.3f} mm.",
            "state" in model.inputs,
        ),
    }


def _fig5(seen: Evidence) -> dict[str, Answer]:
    force = [b for b in BLOCKS if b.group == "force"]
    signal = "f_meas"
    path = []
    while reader := next((b for b in force if signal in b.inputs), None):
        path.append(reader.name)
        signal = reader.outputs[0]
    expected = ["force filter", "generalised inverse", "force law", "to operational space"]
    sensed = [force["sensing_rms_rel"] for force in seen.verdict["force"].values()]
    rate = float(seen.recording.meta["control_rate_hz"])
    faster = np.linalg.norm(np.diff(seen["twist"][:, :3], axis=0), axis=1).max() * rate
    answers = {
        "path": Answer(f"As wired in a tick: {' → '.join(path)}.", path == expected),
        "filter": Answer(
            f"While the rod accelerates by up to {faster:.2f} m/s², the filtered magnitudes are "
            f"the plant's true ones within {_each(sensed, '{:.2g} %', 100.0)} rms.",
            max(sensed) <= 0.01,
            "within 1 % of the mean command",
        ),
    }
    quiet = judged_ticks(seen.recording)[1][seen.recording["t"] >= SETTLE_S - 1e-9]
    if not quiet.all():
        error = np.linalg.norm(seen["motion_error"][:, :3], axis=1)
        usual = error[quiet].max()
        worst = error[~quiet].max()
        answers["motion"] = Answer(
            f"While a desired force steps the error of the free motion stays below "
            f"{1e3 * worst:.4f} mm, otherwise below {1e3 * usual:.4f} mm.",
            bool(worst <= 1e-5),
            "less than 0.01 mm",
        )
    return answers


def _fig6(seen: Evidence) -> dict[str, Answer]:
    power = seen.verdict["power"]
    closed = min(seen.verdict["contact_fraction"].values())
    return {
        "reciprocal": Answer(
            f"Contacts closed {100 * closed:.2f} % of the time; the projected power is "
            f"{power['ratio']:.3g} of the total, rms.",
            closed == 1.0 and power["ratio"] <= 0.02,
            "contacts always closed, ratio up to 0.02 (the plant's contacts are slightly soft; "
            "rigid ones give rounding errors: --plant rigid)",
        ),
        "total": Answer(
            f"{1e3 * power['total_rms_W']:.3g} mW rms; projected, "
            f"{1e3 * power['projected_rms_W']:.3g} mW.",
            power["total_rms_W"] > power["projected_rms_W"],
        ),
    }


def _fig8(seen: Evidence) -> dict[str, Answer]:
    forces = seen.verdict["force"].values()
    keys = ("rms_error_rel", "peak_error_rel", "sensing_rms_rel")
    rms, peak, sensed = ([f[key] for f in forces] for key in keys)
    mean = [f["mean_command_N"] for f in forces]
    N = seen["N"]
    looks = np.linspace(0, len(N) - 1, LOOKS).astype(int)
    framed = sum(bool(as_raibert_craig(N[k], ROD)) for k in looks)
    rank = N.shape[2]
    return {
        "follow": Answer(
            f"True force minus desired: {_each(rms, '{:.3g} %', 100.0)} rms, "
            f"{_each(peak, '{:.2g} %', 100.0)} peak, of {_each(mean, '{:.2f} N')}; measured "
            f"minus true: {_each(sensed, '{:.2g} %', 100.0)} rms.",
            max(rms) <= 0.01 and max(peak) <= 0.05,
            "1 % rms, 5 % peak",
        ),
        "space": Answer(
            f"N has {rank} columns; a constraint frame was found at {framed} of {LOOKS} moments of "
            "the run.",
            rank == 2 and framed == 0,
            "at none",
        ),
    }


def _each(values: Sequence[float], form: str, scale: float = 1.0) -> str:
    return " and ".join(form.format(scale * value) for value in values)


ANSWERS: dict[str, Callable[[Evidence], dict[str, Answer]]] = {
    "fig1": _fig1,
    "fig4": _fig4,
    "fig5": _fig5,
    "fig6": _fig6,
    "fig8": _fig8,
}
FIGURES = tuple(ANSWERS)
