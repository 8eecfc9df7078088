"""Plots of a recording: contact forces (fig. 8), power (figs. 6, 7), tracking, torques.

Each function returns a matplotlib figure and shows nothing; `save` writes it as PNG and SVG.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from osc_contact.errors import InvalidInputError
from osc_contact.visual import OKABE_ITO, contact_colour

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from osc_contact.recorder import Recording

__all__ = ["style", "contact_forces", "power", "tracking", "torques", "save"]

BLANK = 0.05
"""Length in s of the window after a force step that `power` shades and leaves out of the rms."""
_AXES = ("x", "y", "z")
_TRIPLE = tuple(OKABE_ITO[name] for name in ("blue", "vermillion", "green"))
Array = NDArray[np.float64]


@contextmanager
def style() -> Iterator[None]:
    """The one look of all figures: Okabe-Ito colours, light grid, no box, constrained layout."""
    import matplotlib
    from cycler import cycler

    cycle = [OKABE_ITO[n] for n in ("blue", "vermillion", "green", "purple", "orange", "sky")]
    look: Any = {
        "axes.prop_cycle": cycler(color=[*cycle, OKABE_ITO["black"], "#999999"]),
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.grid": True,
        "axes.axisbelow": True,
        "axes.titlesize": 10,
        "axes.titlelocation": "left",
        "axes.labelsize": 9.5,
        "grid.color": "#E3E5E8",
        "grid.linewidth": 0.6,
        "xtick.labelsize": 9,
        "ytick.labelsize": 9,
        "legend.fontsize": 8.5,
        "legend.frameon": False,
        "lines.linewidth": 1.1,
        "mathtext.fontset": "dejavusans",
        "figure.constrained_layout.use": True,
        "figure.facecolor": "white",
        "svg.fonttype": "path",
        "svg.hashsalt": "osc_contact",
    }
    with matplotlib.rc_context(look):
        yield


def contact_forces(recording: Recording) -> Figure:
    """Fig. 8: per contact the desired, measured and true force; below, the errors of them all.

    Raises:
        InvalidInputError: a channel is missing.
    """
    t = _get(recording, "t")
    names = [str(name) for name in recording.meta.get("contact_names", [])]
    with style():
        figure, axes = _panels(len(names) + 1, 2.0)
        if not names:
            axes[0].text(0.5, 0.5, "no contacts", transform=axes[0].transAxes, ha="center")
            axes[0].set(xlabel="time (s)", ylabel="force (N)")
            return figure
        desired, measured, true = (
            _get(recording, key) for key in ("alpha_cmd", "alpha_meas", "alpha_true")
        )
        for i, (name, ax) in enumerate(zip(names, axes, strict=False)):
            colour = contact_colour(i)
            ax.plot(t, measured[:, i], color=colour, alpha=0.4, lw=0.8, label="measured")
            ax.plot(t, true[:, i], color=colour, label="true")
            ax.plot(t, desired[:, i], color="black", lw=1.0, ls="--", label="desired")
            ax.set(title=name.replace("_", " "), ylabel=rf"$\alpha_{{{i + 1}}}$ (N)")
            _legend(ax)
            error = true[:, i] - desired[:, i]
            label = f"{name.replace('_', ' ')}, rms {_rms(error):.3g} N"
            axes[-1].plot(t, error, color=colour, lw=0.9, label=label)
        axes[-1].set(title="error: true − desired", ylabel="error (N)", xlabel="time (s)")
        _legend(axes[-1])
    return figure


def power(recording: Recording, blank_after: Sequence[float] = ()) -> Figure:
    """Figs. 6, 7: total power, projected power on the same scale, projected power enlarged.

    Args:
        recording: needs ``t``, ``power_total``, ``power_projected``.
        blank_after: times (s) of force steps; the 50 ms after each are shaded and left out of
            the rms values and of the enlarged scale.

    Raises:
        InvalidInputError: a channel is missing.
    """
    t = _get(recording, "t")
    total, projected = _get(recording, "power_total"), _get(recording, "power_projected")
    blank = np.zeros(t.shape, dtype=bool)
    for start in blank_after:
        blank |= (t >= start) & (t < start + BLANK)
    counted = ~blank if not blank.all() else np.ones(t.shape, dtype=bool)
    rms = [_rms(series[counted]) for series in (total, projected)]
    with style():
        figure, axes = _panels(3, 2.1)
        titles = (
            rf"total $\vartheta^T f'_{{meas}}$: rms {_si(rms[0], 'W')}",
            rf"projected $\vartheta^T \Omega_f f'_{{meas}}$: rms {_si(rms[1], 'W')}",
            "projected, enlarged",
        )
        for ax, series, title, colour in zip(
            axes,
            (total, projected, projected),
            titles,
            (OKABE_ITO["blue"], OKABE_ITO["vermillion"], OKABE_ITO["vermillion"]),
            strict=True,
        ):
            ax.plot(t, series, color=colour, lw=0.9)
            ax.set(title=title, ylabel="power (W)")
            for start in blank_after:
                shade = ax.axvspan(start, start + BLANK, color="#B8BDC4", alpha=0.6, lw=0)
        both = np.concatenate([total, projected])
        for ax in axes[:2]:
            ax.set_ylim(_limits(both))
        axes[2].set_ylim(_limits(projected[counted]))
        axes[2].set_xlabel("time (s)")
        if len(blank_after):
            label = f"{1e3 * BLANK:.0f} ms after a force step, not in the rms"
            axes[0].legend(
                [shade], [label], loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.1
            )
    return figure


def tracking(recording: Recording) -> Figure:
    """Projected motion error (mm and mrad) and the object's way from its start (mm).

    Raises:
        InvalidInputError: a channel is missing.
    """
    t, error = _get(recording, "t"), 1e3 * _get(recording, "motion_error")
    way = 1e3 * (_get(recording, "pose")[:, :3] - _get(recording, "pose")[0, :3])
    with style():
        figure, axes = _panels(3, 2.1)
        linear, angular = (_rms(np.linalg.norm(e, axis=1)) for e in (error[:, :3], error[:, 3:]))
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
            _legend(ax)
        axes[-1].set_xlabel("time (s)")
    return figure


def torques(recording: Recording) -> Figure:
    """Actuator efforts over time, one panel per arm.

    Raises:
        InvalidInputError: a channel is missing.
    """
    t, tau = _get(recording, "t"), _get(recording, "tau")
    names = _actuated_names(recording.meta, tau.shape[1])
    arms = [str(name) for name in recording.meta.get("arm_names", [])]
    groups = {arm: [i for i, n in enumerate(names) if n.startswith(arm)] for arm in arms}
    if sorted(i for group in groups.values() for i in group) != list(range(len(names))):
        groups = {"all actuators": list(range(len(names)))}
    with style():
        figure, axes = _panels(len(groups), 2.6)
        for ax, (title, columns) in zip(axes, groups.items(), strict=True):
            for i in columns:
                ax.plot(t, tau[:, i], lw=0.9, label=names[i].removeprefix(title).lstrip("/_. "))
            ax.set(title=title.replace("_", " "), ylabel="effort (N·m; prismatic: N)")
            _legend(ax)
        axes[-1].set_xlabel("time (s)")
    return figure


def save(figure: Figure, path_without_suffix: str | Path) -> tuple[Path, Path]:
    """Write the figure as PNG (150 dpi) and SVG; each file appears complete or not at all.

    Returns:
        The paths of the PNG and of the SVG.
    """
    base = Path(path_without_suffix)
    base.parent.mkdir(parents=True, exist_ok=True)
    written = []
    extras: tuple[tuple[str, Any], ...] = ((".png", {}), (".svg", {"metadata": {"Date": None}}))
    for suffix, extra in extras:
        target = base.with_name(base.name + suffix)
        descriptor, temporary = tempfile.mkstemp(dir=base.parent, prefix=f".{target.name}.")
        try:
            with os.fdopen(descriptor, "wb") as file:
                figure.savefig(file, dpi=150, format=suffix[1:], **extra)
            os.chmod(temporary, 0o644)
            os.replace(temporary, target)
        except BaseException:
            os.unlink(temporary)
            raise
        written.append(target)
    return written[0], written[1]


def _get(recording: Recording, key: str) -> Array:
    if key not in recording.channels:
        raise InvalidInputError(
            f"the recording has no channel {key!r}; it has {sorted(recording.channels)}"
        )
    return np.asarray(recording.channels[key], dtype=float)


def _panels(count: int, height: float) -> tuple[Figure, Sequence[Axes]]:
    """Panels below one another with one time axis; Agg canvas, no global state."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.0, height * count + 0.4))
    FigureCanvasAgg(figure)
    axes = figure.subplots(count, 1, sharex=True, squeeze=False)[:, 0]
    for ax in axes:
        ax.margins(x=0.0)
    figure.align_ylabels(axes)
    return figure, list(axes)


def _legend(ax: Axes) -> None:
    ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.2)


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
        if value >= factor:
            return f"{value / factor:.3g} {prefix}{unit}"
    return f"{value:.2g} {unit}"
