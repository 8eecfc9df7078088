"""Plots of a recording: contact forces (fig. 8), power (figs. 6, 7), tracking, torques.

Each function returns a matplotlib figure and shows nothing; `save` writes it as PNG and SVG.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from osc_contact.errors import InvalidInputError
from osc_contact.recorder import Recording
from osc_contact.visual import OKABE_ITO, contact_colour
from osc_contact.visual.style import legend, panels, save, style

__all__ = ["style", "contact_forces", "power", "tracking", "torques", "save"]

_AXES = ("x", "y", "z")
_TRIPLE = tuple(OKABE_ITO[name] for name in ("blue", "vermillion", "green"))
Array = NDArray[np.float64]
NEAR_LIMIT = 60.0  # %: from there on the limits are drawn


def contact_forces(recording: Recording, judged: NDArray[np.bool_] | None = None) -> Figure:
    """Fig. 8: per contact the desired, true and measured force; below, the errors of them all.

    Nothing is cut off: the error is drawn to scale as far as it is judged, beyond that its
    logarithm is.

    Args:
        recording: needs ``t``, ``alpha_cmd``, ``alpha_true``, ``alpha_meas``.
        judged: (T, r) which ticks of each force are (`judged_ticks`): the others are shaded, below
            where none is. The rms and peak values leave them out. None: all.

    Raises:
        InvalidInputError: a channel is missing.
    """
    t = _get(recording, "t")
    names = recording.magnitude_names
    with style():
        figure, axes = panels(len(names) + 1, 2.0)
        if not names:
            axes[0].text(0.5, 0.5, "no contacts", transform=axes[0].transAxes, ha="center")
            axes[0].set(xlabel="time (s)", ylabel="force (N)")
            return figure
        desired, measured, true = (
            _get(recording, key) for key in ("alpha_cmd", "alpha_meas", "alpha_true")
        )
        counted = _counted(true.shape, judged)
        for i, (name, ax) in enumerate(zip(names, axes, strict=False)):
            colour, here = contact_colour(i), counted[:, i]
            ax.plot(t, desired[:, i], color="#B4BAC2", lw=5.0, label="desired")
            ax.plot(t, true[:, i], color=colour, lw=1.8, label="true")
            ax.plot(t, measured[:, i], color="black", lw=0.9, ls=(0, (4, 6)), label="measured")
            ax.set(title=name.replace("_", " "), ylabel=rf"$\alpha_{{{i + 1}}}$ (N)")
            _shade(ax, t, here)
            legend(ax)
            error = true[:, i] - desired[:, i]
            rms, peak = _rms(error[here]), float(np.nanmax(np.abs(error[here]), initial=0.0))
            label = f"{name.replace('_', ' ')}\nrms {_si(rms, 'N')}, peak {_si(peak, 'N')}"
            axes[-1].plot(t, error, color=colour, lw=0.9, label=label)
        _shade(axes[-1], t, np.logical_or.reduce(counted, axis=1))
        _scale_errors(axes[-1], true - desired, counted)
        note = " (shaded: not in rms and peak)" if not counted.all() else ""
        title = f"error: true − desired{note}"
        axes[-1].set(title=title, ylabel="error (N)", xlabel="time (s)")
        legend(axes[-1])
    return figure


def power(recording: Recording, judged: NDArray[np.bool_] | None = None) -> Figure:
    """Figs. 6, 7: total power on top, projected power on the same scale, and that one enlarged.

    Args:
        recording: needs ``t``, ``power_total``, ``power_projected``.
        judged: (T,) which ticks are (`judged_ticks`): the others are shaded and left out of the rms
            values and of the enlarged scale. None: all.

    Raises:
        InvalidInputError: a channel is missing.
    """
    t = _get(recording, "t")
    total, projected = _get(recording, "power_total"), _get(recording, "power_projected")
    counted = _counted(total.shape, judged)
    rms = [_rms(series[counted]) for series in (total, projected)]
    with style():
        figure, axes = panels(3, 2.1)
        contents = (
            (total, rf"total $\vartheta^T f'_{{meas}}$: rms {_si(rms[0], 'W')}", "blue"),
            (
                projected,
                rf"projected $\vartheta^T \Omega_f f'_{{meas}}$: rms {_si(rms[1], 'W')}",
                "vermillion",
            ),
            (projected, "projected, enlarged", "vermillion"),
        )
        for ax, (series, title, colour) in zip(axes, contents, strict=True):
            ax.plot(t, series, color=OKABE_ITO[colour], lw=0.9)
            ax.set(title=title, ylabel="power (W)")
            shade = _shade(ax, t, counted)
        both = np.concatenate([total, projected])
        for ax in axes[:2]:
            ax.set_ylim(_limits(both))
        axes[2].set_ylim(_limits(projected[counted]))
        axes[2].set_xlabel("time (s)")
        if shade is not None:
            axes[0].legend(
                [shade], ["not in the rms: settling, landings, force steps"], loc="lower right",
                bbox_to_anchor=(1.0, 1.0), borderaxespad=0.1,
            )  # fmt: skip
    return figure


def tracking(recording: Recording, judged_from: float = 0.0) -> Figure:
    """Projected motion error (mm and mrad) and the object's way from its start (mm).

    Args:
        recording: needs ``t``, ``motion_error``, ``pose``.
        judged_from: s; what lies before is shaded and left out of the rms values.

    Raises:
        InvalidInputError: a channel is missing.
    """
    t, error = _get(recording, "t"), 1e3 * _get(recording, "motion_error")
    way = 1e3 * (_get(recording, "pose")[:, :3] - _get(recording, "pose")[0, :3])
    with style():
        figure, axes = panels(3, 2.1)
        counted = _counted(t.shape, t >= judged_from - 1e-9)
        judged = error[counted]
        linear, angular = (_rms(np.linalg.norm(e, axis=1)) for e in (judged[:, :3], judged[:, 3:]))
        contents = (
            (error[:, :3], f"motion error along the free directions: rms {linear:.3g} mm",
             "linear error (mm)", _AXES),
            (error[:, 3:], f"rotation error along the free directions: rms {angular:.3g} mrad",
             "angular error (mrad)", tuple(rf"about {a}" for a in _AXES)),
            (way, "object position, from its start", "position (mm)", _AXES),
        )  # fmt: skip
        for ax, (series, title, unit, labels) in zip(axes, contents, strict=True):
            for column, label, colour in zip(series.T, labels, _TRIPLE, strict=True):
                ax.plot(t, column, color=colour, label=label)
            ax.set(title=title, ylabel=unit)
            _shade(ax, t, counted)
            legend(ax)
        axes[-1].set_xlabel("time (s)")
    return figure


def torques(recording: Recording) -> Figure:
    """Actuator efforts over time, one panel per arm: in percent of each motor's limit.

    Without limits in the recording: in N m, of sliding joints in N.

    Raises:
        InvalidInputError: a channel is missing.
    """
    t, tau = _get(recording, "t"), _get(recording, "tau")
    names = _actuated_names(recording.meta, tau.shape[1])
    arms = [str(name) for name in recording.meta.get("arm_names", [])]
    groups = {arm: [i for i, n in enumerate(names) if n.startswith(arm)] for arm in arms}
    if sorted(i for group in groups.values() for i in group) != list(range(len(names))):
        groups = {"all actuators": list(range(len(names)))}
    recorded = recording.meta.get("effort_limits") or {}
    limits = [recorded.get(name) for name in names]
    known = all(limits)
    shown = 100.0 * tau / np.array(limits, dtype=float) if known else tau
    unit = "effort (% of its limit)" if known else "effort (N m; sliding joints: N)"
    with style():
        figure, axes = panels(len(groups), 2.6)
        for ax, (title, columns) in zip(axes, groups.items(), strict=True):
            for i in columns:
                name = names[i].removeprefix(title).lstrip("/_. ")
                peak = f", peak {np.nanmax(np.abs(shown[:, i])):.0f} %" if known else ""
                ax.plot(t, shown[:, i], lw=0.9, label=name + peak)
            ax.set(title=title.replace("_", " "), ylabel=unit)
            if known and np.nanmax(np.abs(shown[:, columns])) > NEAR_LIMIT:
                for limit in (-100.0, 100.0):
                    ax.axhline(limit, color="black", lw=0.9, ls="--")
            legend(ax)
        axes[-1].set_xlabel("time (s)")
    return figure


def _get(recording: Recording, key: str) -> Array:
    if key not in recording.channels:
        raise InvalidInputError(
            f"the recording has no channel {key!r}; it has {sorted(recording.channels)}"
        )
    return np.asarray(recording.channels[key], dtype=float)


def _actuated_names(meta: dict[str, Any], count: int) -> list[str]:
    """Names of the actuated joints: the recorded names, without the scenario's passive joints."""
    names = [str(name) for name in meta.get("joint_names", [])]
    scenario = meta.get("scenario", {})
    arms = scenario.get("arms", []) if isinstance(scenario, dict) else []
    passive = [(arm["name"], joint) for arm in arms for joint in arm.get("passive_joints", [])]
    driven = [
        name
        for name in names
        if not any(name.startswith(arm) and name.endswith(joint) for arm, joint in passive)
    ]
    for candidate in (names, driven):
        if len(candidate) == count:
            return candidate
    return [f"actuator {i + 1}" for i in range(count)]


def _counted(shape: tuple[int, ...], judged: NDArray[np.bool_] | None) -> NDArray[np.bool_]:
    """The values that count: those judged; all of them if none is."""
    every = np.ones(shape, dtype=bool)
    return every if judged is None or not judged.any() else judged & every


def _shade(ax: Axes, t: Array, counted: NDArray[np.bool_]) -> Artist | None:
    """Shade the ticks that do not count; returns one of the patches for a legend."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], ~counted, [False])).astype(int)))
    patch = None
    for start, stop in edges.reshape(-1, 2):
        end = t[min(stop, len(t) - 1)]
        patch = ax.axvspan(float(t[start]), float(end), color="#B8BDC4", alpha=0.6, lw=0)
    return patch


def _scale_errors(ax: Axes, error: Array, counted: NDArray[np.bool_]) -> None:
    """Errors as far as they are judged to scale, larger ones by their logarithm."""
    largest = float(np.nanmax(np.abs(error), initial=0.0))
    linear = float(np.nanmax(np.abs(error[counted]), initial=0.0))
    if largest > 3.0 * linear > 0.0:
        ax.set_yscale("symlog", linthresh=linear, linscale=3.0)
        ax.set_ylim(-2.0 * largest, 2.0 * largest)
    else:
        ax.set_ylim(_limits(error))


def _rms(values: Array) -> float:
    return float(np.sqrt(np.nanmean(np.square(values)))) if np.isfinite(values).any() else 0.0


def _limits(values: Array) -> tuple[float, float]:
    """Limits with 5 % air around the finite values; never an empty range."""
    finite = values[np.isfinite(values)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 0.0)
    air = 0.05 * (high - low) or 1e-3
    return low - air, high + air


def _si(value: float, unit: str) -> str:
    """Value with three digits and the prefix m or µ where it helps."""
    for factor, prefix in ((1.0, ""), (1e-3, "m"), (1e-6, "µ")):
        if value >= 0.9995 * factor:
            return f"{value / factor:.3g} {prefix}{unit}"
    return f"{value:.2g} {unit}"
