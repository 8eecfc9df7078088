"""The contact state of fig. 2, and a run in it."""

from __future__ import annotations

from textwrap import fill
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from osc_contact.visual import contact_colour
from osc_contact.visual.cone_picture import draw_cone_in_groove
from osc_contact.visual.style import legend, panels, style
from paper.cone_in_groove.geometry import Seat
from paper.cone_in_groove.run import ConeResult

__all__ = ["draw_run", "draw_state"]


def draw_state(seat: Seat) -> Figure:
    """Cone, groove, t₁, t₂ and the four lines of force that span N."""
    X, cone, groove = seat.X_start, seat.cone, seat.groove
    points, directions = seat.wall_forces(X)
    frame = seat.contact().as_raibert_craig(cone.height)
    words = (
        "$t_1$: rotation about the cone's axis",
        "$t_2$: translation along the groove's axis",
        r"$\mathbf{T} = [\,t_1\ t_2\,],\quad "
        r"\mathbf{N} = [\,f_{c1}\ f_{c2}\ f_{c3}\ f_{c4}\,],\quad \mathbf{N}^T\mathbf{T} = 0$",
        "",
        "No constraint frame with selected axes describes it:",
        fill(frame.reason, 52),
        f"(nearest frame: {np.rad2deg(np.arcsin(frame.residual)):.0f}° off, moments per height)",
    )
    return draw_cone_in_groove(
        apex=X.act(cone.apex),
        axis=seat.axis,
        height=cone.height,
        half_angle=seat.half_angle,
        groove=groove.direction,
        normals=groove.normals(),
        points=points,
        directions=directions,
        title="Fig. 2: a cone in a groove; its axes of motion are neither parallel nor "
        "perpendicular",
        words=words,
    )


def draw_run(result: ConeResult) -> Figure:
    """Four forces and two motions controlled at once: desired, true and errors."""
    t = result.t
    black: dict[str, Any] = {"color": "black", "lw": 1.0, "ls": (0, (4, 3)), "zorder": 3}
    with style():
        figure, axes = panels(5, 1.55)
        forces, force_errors, turn, slide, motion_errors = axes
        for i in range(4):
            colour, name = contact_colour(i), rf"$f_{{c{i + 1}}}$"
            forces.plot(t, result.wall[:, i], color=colour, lw=2.0, label=name)
            forces.plot(t, result.wall_d[:, i], **black)
            error = result.wall[:, i] - result.wall_d[:, i]
            force_errors.plot(t, 1e3 * error, color=colour, lw=0.9)
        forces.plot([], [], **black, label="desired")
        forces.set(ylabel="force (N)", title="A Panda presses the cone on both walls …")
        force_errors.set(ylabel="true − desired\n(mN)")
        for k, (ax, scale, unit) in enumerate(((turn, 180 / np.pi, "°"), (slide, 1e3, "mm"))):
            colour = contact_colour(4 + k)
            ax.plot(t, scale * result.motion[:, k], color=colour, lw=2.0, label="true")
            ax.plot(t, scale * result.motion_d[:, k], **black, label="desired")
            ax.set(ylabel=f"{('turn $t_1$', 'slide $t_2$')[k]} ({unit})")
            error = 1e3 * (result.motion[:, k] - result.motion_d[:, k])
            motion_errors.plot(
                t, 1e3 * error, color=colour, lw=1.1, label=("turn (µrad)", "slide (µm)")[k]
            )
        turn.set_title("… while it turns and slides", fontsize=10)
        motion_errors.set(ylabel="true − desired\n(µrad, µm)", xlabel="time (s)")
        for ax in axes:
            for step in result.step_times:
                ax.axvline(step, color="#999999", lw=0.8, ls=":", zorder=1)
        for ax in (forces, turn, slide, motion_errors):
            legend(ax)
    return figure
