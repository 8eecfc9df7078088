"""Pictures of contacts made and lost: fig. 7, and landings from free motion."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from osc_contact.recorder import Recording
from osc_contact.visual import OKABE_ITO, contact_colour
from osc_contact.visual.style import legend, panels, style
from paper.contact_phases import Landing, collisions, effort_limits, normal_speeds

__all__ = ["draw_collisions", "draw_landing"]


def draw_collisions(recording: Recording) -> Figure:
    """Fig. 7: total and projected power on one scale; below, the true contact forces.

    Triangles: collisions as the plant knows them; the monitor flagged the filled ones in 20 ms.
    Shaded: a contact is open, and N assumes what is not there.
    """
    t, hits = recording["t"], collisions(recording)
    rows = (
        ("power_total", r"total $\vartheta^T f'_{meas}$", "blue"),
        ("power_projected", r"projected $\vartheta^T \Omega_f f'_{meas}$", "vermillion"),
    )
    with style():
        figure, axes = panels(3, 2.1)
        low = min(recording[key].min() for key, _, _ in rows)
        high = max(recording[key].max() for key, _, _ in rows)
        for ax, (key, title, colour) in zip(axes, rows, strict=False):
            ax.plot(t, recording[key], color=OKABE_ITO[colour], lw=0.9)
            ax.set(title=title, ylabel="power (W)", ylim=(1.1 * low, 1.15 * high))
        for ax in axes:  # the forces build up in the first tick
            ax.fill_between(
                t[1:], 0, 1, where=~recording["closed"][1:].all(axis=1), zorder=0.5,
                transform=ax.get_xaxis_transform(), color="#E3E5E8", lw=0,
                label="a contact is open" if ax is axes[1] else None,
            )  # fmt: skip
        for flagged, face in ((True, OKABE_ITO["black"]), (False, "white")):
            at = [hit.t for hit in hits if (hit.flagged is not None) == flagged]
            label = f"collision, {'' if flagged else 'not '}flagged ({len(at)})"
            axes[1].plot(at, [1.08 * high] * len(at), "v", ms=5, mfc=face, mec="black", label=label)
        legend(axes[1])
        for i, name in enumerate(recording.magnitude_names):
            label = name.replace("_", " ")
            axes[2].plot(t, recording["alpha_true"][:, i], color=contact_colour(i), label=label)
        axes[2].set(title="true contact forces", ylabel="force (N)", xlabel="time (s)")
        legend(axes[2])
    return figure


def draw_landing(runs: Sequence[Landing]) -> Figure:
    """Forces of all runs above; normal speed and torques of the first one below."""
    recording = runs[0].recording
    t, names = recording["t"], recording.magnitude_names
    with style():
        figure, axes = panels(4, 1.9)
        for k, one in enumerate(runs):
            for i, name in enumerate(names):
                label = name.replace("_", " ") if k == 0 else None
                force = one.recording["alpha_true"][:, i]
                axes[0].plot(t, force, color=contact_colour(i), lw=0.8, alpha=0.6, label=label)
        axes[0].plot(t, recording["alpha_cmd"][:, 0], color="#B4BAC2", lw=4, zorder=0,
                     label="desired")  # fmt: skip
        axes[0].set(title=f"true contact forces, {len(runs)} starts", ylabel="force (N)")
        for i, name in enumerate(names):
            gaps = -np.cumsum(normal_speeds(recording)[:, i]) * (t[1] - t[0])
            made = int(np.argmax(recording["closed"][:, i]))
            axes[1].plot(t, 1e3 * (gaps - gaps[made]), color=contact_colour(i),
                         label=name.replace("_", " "))  # fmt: skip
            axes[2].step(t, recording["contact_phase"][:, i] + 0.04 * i, where="post",
                         color=contact_colour(i), label=name.replace("_", " "))  # fmt: skip
        axes[1].set(title=f"gap, seed {runs[0].seed}", ylabel="gap (mm)")
        axes[2].set(title="phase", yticks=(0, 1, 2))
        axes[2].set_yticklabels(("open", "approaching", "closed"))
        share = recording["tau"] / effort_limits(recording)
        for j in range(share.shape[1]):
            axes[3].plot(t, share[:, j], lw=0.8)
        axes[3].set(title="motor torques", ylabel="share of limit", xlabel="time (s)")
        for ax in axes[:3]:
            legend(ax)
    return figure
