"""Fig. 2 of the paper: a Panda presses a cone into a V groove, turns it and slides it, all at once.

T = [t₁ t₂] is known by inspection and no constraint frame describes it: the axes of t₁ and t₂ are
neither parallel nor perpendicular. Four pushes on the walls and two motions are controlled, on the
rigid plant.
"""

from pathlib import Path
from textwrap import fill as fill_text
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

import osc_contact as osc
from osc_contact.lab.visual import OKABE_ITO, plots
from osc_contact.spatial import Array, cross
from paper.baselines import measured_coupling
from paper.contact_pictures import FACE, HALO, draw_arrow, draw_force, draw_line, scale_equally
from paper.selection_laws import Instant, Ours
from paper.statements import Answer
from paper.study import PANDA, Ask, Data, Study, table_of

# --- A cone in a V groove: shapes, contact, and the forces with which it presses on the walls ---


_UP = np.array([0.0, 0.0, 1.0])


class Seat:
    """A cone with its apex on the line of a horizontal groove, which opens upwards.

    A cone whose axis is inclined by φ to the line touches both walls, of half angle β, along a
    generator each if its own half angle θ has sin θ = sin φ sin β. It is gripped off its axis and
    obliquely, so that turning it moves the whole arm. Its inertia stands in `cone.urdf`.

    Attributes:
        point, direction: (3,) of the groove's line, world (m, unit).
        yaw: yaw of the groove, about the vertical (rad).
        normals: (2, 3) unit, of the walls, out of the material.
        apex, cone_axis: (3,) in the object's frame (m), and unit from apex to base.
        height: m.
        inclination, half_angle: φ, θ (rad).
        axis: (3,) of the cone, in the world.
        X_start: pose of the object with the apex in the middle of the groove.
        generators: (2, 3) unit directions from the apex along which the cone touches the walls.
        pair, contact: r = 4, at the start.
        raibert_craig: the nearest constraint frame there, moments over the cone's height about O.
        from_wall_forces: R (4, 4), the pair's magnitudes from those at the ends of the lines of
            contact. N R is the same space of forces seen through another basis. The groove carries
            both, so R is constant.
    """

    def __init__(self) -> None:
        """Seat the cone."""
        yaw, inclination, grip, beta = np.deg2rad([155.0, 32.0, 38.0, 60.0]).tolist()
        self.point = np.array([0.50, 0.05, 0.15])
        self.yaw = yaw
        self.inclination = inclination
        self.direction = np.array([np.cos(yaw), np.sin(yaw), 0.0])
        self.axis = np.cos(inclination) * self.direction + np.sin(inclination) * _UP
        side = np.cos(beta) * cross(_UP, self.direction)
        self.normals = np.sin(beta) * _UP + np.array([side, -side])
        self.apex = np.array([0.02, 0.015, 0.12])
        self.cone_axis = np.array([np.sin(grip), 0.0, -np.cos(grip)])
        self.height = 0.10
        self.half_angle = float(np.arcsin(np.sin(inclination) * np.sin(beta)))
        slope = np.sin(self.half_angle) * self.normals
        self.generators = (self.axis - slope) / np.cos(self.half_angle)
        back = inclination + grip  # of the hand above the groove's line
        x = np.sin(back) * self.direction - np.cos(back) * _UP
        z = -np.cos(back) * self.direction - np.sin(back) * _UP
        R = np.column_stack((x, cross(z, x), z))
        self.X_start = pin.SE3(R, self.point - R @ self.apex)
        shapes = (self.apex, self.cone_axis, self.point, self.direction, self.axis)
        self.pair = osc.ConeInGroove(*shapes, name="cone")
        self.contact = self.pair.contact(self.X_start, np.zeros(6))
        self.raibert_craig = self.contact.as_raibert_craig(self.height)
        points, directions = self.wall_forces(self.X_start)
        arms = points - self.X_start.translation[:, None]
        lines = np.concatenate((directions, cross(arms, directions)))
        self.from_wall_forces = np.linalg.lstsq(self.contact.N, lines, rcond=None)[0]

    def wall_forces(self, X_WO: pin.SE3) -> tuple[Array, Array]:
        """Points (3, 4; m) at which the cone presses on the walls, and directions (3, 4) of forces.

        The lines of contact end where the cone has 35 % and 100 % of its height. Pushes on the two
        ends of both lines are another basis of N, in which a real groove can only push (≥ 0).
        """
        length = self.height / np.cos(self.half_angle)
        normals, along = (np.repeat(two, 2, axis=0).T for two in (self.normals, self.generators))
        points = X_WO.act(self.apex)[:, None] + length * along * [0.35, 1.0, 0.35, 1.0]
        return points, -normals

    def motion(self, X_WO: pin.SE3) -> Array:
        """(2,) how far the cone has turned about its axis (rad) and slid along the groove (m)."""
        turned = pin.log3(X_WO.rotation @ self.X_start.rotation.T) @ self.axis
        slid = (X_WO.act(self.apex) - self.point) @ self.direction
        return np.array([turned, slid])


# --- Fig. 2 as a scenario made in Python: the pair is an object, no file could name it ---


PERIOD = 1e-3  #: s
STEP_TIMES = (2.0, 2.7, 3.4, 4.1)  #: s at which the pushes on the walls step, one after the other
_REST = (9.0, 7.0, 8.0, 10.0)  # N, pushes on the walls
_STEPS = (4.0, -3.0, 5.0, -4.0)  # N
_TURN = {"type": "sine", "amplitude": 0.6, "frequency": 0.4, "ramp": 1.0}  # rad
_SLIDE = {"type": "sine", "amplitude": 0.04, "frequency": 0.55, "ramp": 1.0}  # m


def cone_scenario(
    seat: Seat,
    duration: float = 5.0,
    step_times: tuple[float, ...] = STEP_TIMES,
) -> osc.Scenario:
    """A Panda turns and slides the cone at once while its pushes on the walls step.

    Args:
        seat: groove, and the cone that lies in it.
        duration: s.
        step_times: of the wall forces, one after the other (s); at most four.
    """
    start = seat.X_start
    force = {}
    for i, row in enumerate(seat.from_wall_forces, 1):  # α = R λ: each wall force is in each α
        signals = [{"type": "minimum_jerk", "duration": 0.3, "value": float(row @ _REST)}]
        for value, at in zip(row * _STEPS, step_times, strict=False):
            signals.append({"type": "step", "value": float(value), "start": at})
        force[f"cone.{i}"] = signals
    motion = [
        {"kind": "linear", "direction": seat.direction, "signals": [_SLIDE]},
        {"kind": "angular", "direction": seat.axis, "through": seat.point, "signals": [_TURN]},
    ]
    place = {"xyz": seat.point, "rpy": [0, 0, seat.yaw]}
    pose = {"xyz": start.translation, "rpy": pin.rpy.matrixToRpy(start.rotation)}
    data = {
        "name": "cone_in_groove",
        "arms": [PANDA | {"posture": [0.0, -0.3, 0.0, -2.2, 0.0, 2.0, 0.78]}],
        "object": {"urdf": "cone.urdf", "pose": pose},
        "grasps": {"panda": {}},
        "environment": [{"name": "groove", "urdf": "groove.urdf", "pose": place}],
        "contacts": [{"pair": seat.pair, "body": "groove"}],
        "force": force,
        "motion": motion,
        "gains": {"motion": {"stiffness": 400, "damping": 40}, "force": {"integral": 20}},
        "control": {"rate": 1.0 / PERIOD},
        "plant": {"type": "rigid", "step": PERIOD},
        "duration": duration,
    }
    return osc.Scenario.from_dict(data, Path(__file__))


# --- The run of fig. 2, and how far steps of force and motion disturb each other ---


SETTLE_S = 0.5  #: judged from here on
_PROBED = 50  #: ticks from one probe of the coupling to the next


class ConeRun(NamedTuple):
    """Results of one run.

    Attributes:
        recording: recording of the run.
        walls: of it, but with desired, read and true pushes at the ends of the lines of contact
            (N) as its forces, each just before the torques change: true minus desired is what the
            arm's motion makes of them within a period (it halves with the period), and the integral
            action on it.
        data: the verdict, for JSON.
    """

    recording: osc.Recording
    walls: osc.Recording
    data: Data


def _rms(errors: Array) -> list[float]:
    return np.sqrt((errors**2).mean(axis=0)).tolist()


def run(duration: float = 5.0, step_times: tuple[float, ...] = STEP_TIMES) -> ConeRun:
    """Run the task on the rigid plant at 1 kHz, probing the coupling 20 times per second.

    Args:
        duration, step_times: arguments of `cone_scenario`.

    Raises:
        InvalidInputError: too short to be judged.
    """
    if not duration > SETTLE_S:
        raise osc.InvalidInputError(
            f"duration {duration} s: a run is judged from t = {SETTLE_S:g} s; run it longer"
        )
    seat = Seat()
    scenario = cone_scenario(seat, duration, step_times)
    rig = osc.build_rig(scenario)
    recording = osc.run(scenario)
    t = recording["t"]
    plan = list(rig.references.over(t))
    plant: Any = rig.plant()
    probes = []
    for k in range(_PROBED - 1, len(t), _PROBED):
        plant.q = recording["q"][k]
        plant.v = recording["v"][k]
        plant.hold(recording["tau"][k])
        state = rig.chain.state(plant.q, plant.v)
        instant = Instant(state, seat.pair.contact(state.X_WO, state.V_O))
        probes.append(measured_coupling(rig, Ours(), instant, plant, t[k]).norms)
    to_motion, to_force = np.max(probes, axis=0)
    to_walls = np.linalg.inv(seat.from_wall_forces).T
    desired, read = (recording[name][:-1] @ to_walls for name in ("alpha_cmd", "alpha_meas"))
    true = recording["alpha_true"][1:] @ to_walls
    channels = {"t": t[:-1], "alpha_cmd": desired, "alpha_meas": read, "alpha_true": true}
    walls = osc.Recording(recording.meta | {"contact_names": ["push on the walls"]}, channels)
    poses = [pin.XYZQUATToSE3(pose) for pose in recording["pose"]]
    motion, planned = (
        np.array([seat.motion(X) for X in some]) for some in (poses, [one.X_WD for one in plan])
    )
    judged = t >= SETTLE_S
    late = judged[:-1]
    force_error = (true - desired)[late]
    turn_rms, slide_rms = _rms((motion - planned)[judged])
    turned, slid = np.ptp(motion, axis=0).tolist()
    frame = seat.raibert_craig
    data = {
        "r": seat.contact.r,
        "axes_deg": float(np.rad2deg(seat.inclination)),
        "raibert_craig": {"describes_it": bool(frame), "reason": frame.reason},
        "duration_s": len(t) * PERIOD,
        "wall_force_rms_N": _rms(force_error),
        "wall_force_peak_error_N": float(np.abs(force_error).max()),
        "wall_force_least_N": float(true[late].min()),
        "turn_rms_rad": turn_rms,
        "slide_rms_m": slide_rms,
        "turned_rad": turned,
        "slid_m": slid,
        "force_step_to_motion": float(to_motion),
        "motion_step_to_force": float(to_force),
        "contact_power_W": float(np.abs(recording["power_projected"][judged]).max()),
    }
    return ConeRun(recording, walls, data)


# --- The contact state of fig. 2, and a run in it ---


def draw_state(seat: Seat) -> Figure:
    """Cone, groove, t₁, t₂ and the four lines of force that span N."""
    h = seat.height
    groove = seat.direction
    apex = seat.point
    words = (
        "$t_1$: rotation about the cone's axis",
        "$t_2$: translation along the groove's axis",
        r"$\mathbf{T} = [\,t_1\ t_2\,],\quad "
        r"\mathbf{N} = [\,f_{c1}\ f_{c2}\ f_{c3}\ f_{c4}\,],\quad \mathbf{N}^T\mathbf{T} = 0$",
        "",
        "No constraint frame with selected axes describes it:",
        fill_text(seat.raibert_craig.reason, 52),
    )
    with plots.style():
        figure = Figure(figsize=(10.5, 6.2))
        figure.set_layout_engine("none")
        ax: Any = figure.add_axes((-0.02, -0.06, 0.68, 1.0), projection="3d", proj_type="ortho")
        ax.computed_zorder = False
        ax.set_axis_off()
        ax.view_init(33.0, np.rad2deg(seat.yaw) + 209.0)
        for normal in seat.normals:
            down = np.cross(normal, groove)
            corners = np.array([(-0.5, 0.0), (1.5, 0.0), (1.5, 0.95), (-0.5, 0.95)])
            wall = apex + h * corners @ [groove, np.sign(down[2]) * down]
            ax.add_collection3d(Poly3DCollection([wall], **FACE))
        rim = _circle(seat, h, h * np.tan(seat.half_angle), np.linspace(0.0, 2.0 * np.pi, 61))
        side = np.moveaxis(np.array([np.broadcast_to(apex, rim.shape), rim]), 2, 0)
        ax.plot_surface(*side, color="#A9AFB8", alpha=0.3, lw=0.0)
        draw_line(ax, rim, color="#4A4F57", lw=1.3)
        points, directions = (columns.T for columns in seat.wall_forces(seat.X_start))
        for i, (p, d) in enumerate(zip(points, directions, strict=True)):
            draw_line(ax, (apex, p), color="#22262B", lw=3.0)
            draw_force(ax, i, p, 0.36 * h * d, (-1.3, 0.8), 1.0)
        _draw_axes(ax, seat)
        scale_equally(ax, 1.45)
        title = "Fig. 2: a cone in a groove; its axes of motion are neither parallel nor "
        figure.suptitle(title + "perpendicular")
        figure.legend(loc="upper left", bbox_to_anchor=(0.65, 0.88))
        figure.text(0.66, 0.55, "\n".join(words), size=9, va="top", linespacing=1.5)
    return figure


def _draw_axes(ax: Any, seat: Seat) -> None:
    """t₁ with a round arrow, t₂ with a straight one, and between them their angle."""
    h = seat.height
    for name, axis, colour, start in (
        ("$t_1$", seat.axis, OKABE_ITO["black"], -0.25),
        ("$t_2$", seat.direction, "#5B3A8E", -0.7),
    ):
        ends = seat.point + h * np.outer((start, 2.0), axis)
        draw_line(ax, ends, color=colour, lw=1.8, ls="-.")
        ax.text(*(seat.point + 2.2 * h * axis), name, color=colour, size=15, ha="center")
    draw_arrow(ax, seat.point + 1.7 * h * seat.direction, 0.3 * h * seat.direction, "#5B3A8E")
    ring = _circle(seat, 1.62 * h, 0.2 * h, np.linspace(0.35, 5.7, 60))
    draw_line(ax, ring, color=OKABE_ITO["black"], lw=2.2)
    draw_arrow(ax, ring[-2], 6.0 * (ring[-1] - ring[-2]), OKABE_ITO["black"])
    middle = seat.point + 0.78 * h * (seat.axis + seat.direction)
    angle = f"{np.rad2deg(seat.inclination):.0f}°"
    ax.text(*middle, angle, size=11, ha="center", bbox=HALO)


def _circle(seat: Seat, height: float, radius: float, angles: Array) -> Array:
    """(k, 3) points around the cone's axis, in a height above the apex (m)."""
    x = np.cross(seat.axis, seat.direction)
    x /= np.linalg.norm(x)
    turned = np.outer(np.cos(angles), x) + np.outer(np.sin(angles), np.cross(seat.axis, x))
    return seat.point + height * seat.axis + radius * turned


def study(ask: Ask) -> Study:
    """Fig. 2: the run, its numbers, and what they say to the paper's statements."""
    result = run(ask.lasting(5.0))
    data = result.data
    frame = data["raibert_craig"]
    turned = f"{np.rad2deg(data['turned_rad']):.1f}°"
    slid = f"{1e3 * data['slid_m']:.1f} mm"
    rows = ((key, np.array2string(np.array(x), precision=3)) for key, x in data.items())
    answers = {
        "freedoms": Answer(
            f"T has {6 - data['r']} columns. A Panda turns the cone by {turned} and slides it by "
            f"{slid} while all four wall forces push.",
            data["r"] == 4 and data["wall_force_least_N"] > 0.0,
        ),
        "axes": Answer(f"They are {data['axes_deg']:.1f}° apart.", 1.0 < data["axes_deg"] < 89.0),
        "frame": Answer(f"No frame: {frame['reason']}.", not frame["describes_it"]),
    }
    title = "fig. 2: a Panda turns a cone in its groove"
    figures = {
        "fig2": draw_state(Seat()),
        "fig2_forces": plots.contact_forces(result.walls),
        "fig2_motion": plots.tracking(result.recording, SETTLE_S),
    }
    return Study(figures, table_of(title, "quantity; value", rows), data, answers)
