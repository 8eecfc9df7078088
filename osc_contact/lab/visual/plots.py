"""Plots of a recording: contact forces (fig. 8), power (figs. 6, 7), tracking, torques.

Each function returns a matplotlib figure and shows nothing; `save` writes it as PNG and SVG. All
figures have one look: `style`, and stacked `panels` with one time axis.
"""

from collections.abc import Sequence
from contextlib import AbstractContextManager
from pathlib import Path

import matplotlib
import numpy as np
from cycler import cycler
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from osc_contact.files import whole_file
from osc_contact.lab.visual import CONTACT_COLOURS, OKABE_ITO, contact_colour
from osc_contact.recorder import Recording
from osc_contact.spatial import Array

Judged = NDArray[np.bool_]
PRINT = (".png", ".svg", ".pdf")  #: of a figure of the paper or of a study
_DPI = 150  # of a PNG, and of the layout
NEAR_LIMIT = 60.0  # %: from there on the limits are drawn

# --- The one look of all figures ----------------------------------------------------------------


def style() -> AbstractContextManager[None]:
    """Context with the look of all figures: Okabe-Ito colours, light grid, no box."""
    return matplotlib.rc_context(
        {
            "axes.prop_cycle": cycler(color=[*CONTACT_COLOURS, OKABE_ITO["black"], "#999999"]),
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
            "pdf.fonttype": 42,
            "svg.hashsalt": "osc_contact",
        }
    )


def panels(count: int, height: float) -> tuple[Figure, Sequence[Axes]]:
    """Make panels below one another with a common time axis (s).

    The figure has an Agg canvas and no global state of pyplot, so that threads may draw.

    Args:
        count: number of panels.
        height: height of a panel (inch).
    """
    figure = Figure(figsize=(8.0, height * count + 0.4))
    axes = figure.subplots(count, 1, sharex=True, squeeze=False)[:, 0]
    for ax in axes:
        ax.margins(x=0.01)  # the first moments do not hide in the axis
    axes[-1].set_xlabel("time (s)")
    figure.align_ylabels(axes)
    return (figure, list(axes))


def legend(ax: Axes) -> None:
    """Legend right of the panel, where it covers nothing."""
    ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.2)


def save(
    figure: Figure, path_without_suffix: str | Path, suffixes: Sequence[str] = (".png", ".svg")
) -> tuple[Path, ...]:
    """Write the figure as PNG (150 dpi), SVG, PDF; each file appears complete or not at all.

    Args:
        figure: to write.
        path_without_suffix: the suffixes are appended to it.
        suffixes: one file each.

    Returns:
        The paths, one for each suffix.
    """
    base = Path(path_without_suffix)
    paths = []
    metadata = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}}
    with matplotlib.rc_context({"figure.constrained_layout.use": False}):
        _lay_out(figure)
        for suffix in suffixes:
            paths.append(base.with_name(base.name + suffix))
            with whole_file(paths[-1]) as unfinished:
                figure.savefig(
                    unfinished, dpi=_DPI, format=suffix[1:], metadata=metadata.get(suffix)
                )
    return tuple(paths)


def _lay_out(figure: Figure) -> None:
    """Place the parts of a figure, once and alike for all of its files.

    The layout engine is taken away: `savefig` draws a figure that has one twice, the first time for
    the layout alone. While rcParams have a constrained layout in use, matplotlib restores one.
    """
    engine = figure.get_layout_engine()
    if engine is None:
        return
    dpi = figure.dpi
    figure.set_dpi(_DPI)
    engine.execute(figure)
    figure.set_dpi(dpi)
    figure.set_layout_engine(None)


def draw_forces(recording: Recording, folder: Path) -> str:
    """Draw the commanded and the measured force of a recording's first contact into a PNG file.

    Returns:
        The name of the file.
    """
    with style():
        figure, (axes, *_) = panels(1, 2.5)
        for key, label in (("alpha_cmd", "commanded"), ("alpha_meas", "measured")):
            axes.plot(recording["t"], recording[key][:, 0], label=label)
        axes.set(xlabel="time (s)", ylabel="force (N)")
        axes.legend()
    return save(figure, folder / "forces", (".png",))[0].name


# --- Plots ---------------------------------------------------------------------------------------


def contact_forces(recording: Recording, judged: Judged | None = None) -> Figure:
    """Fig. 8: the desired, true and measured force of each contact; below, the errors of all.

    No error is cut off: it is drawn to scale up to the largest one that is judged, and beyond that
    by its logarithm.

    Args:
        recording: needs ``t``, ``alpha_cmd``, ``alpha_true``, ``alpha_meas``.
        judged: (T, r) True for the ticks in which each force is judged (`judged_ticks`). The others
            are shaded, in the lowest panel where no force is judged, and left out of the rms and
            peak values. None: all are judged.

    Raises:
        RecordingError: a channel is missing.
    """
    t = recording["t"]
    names = [name.replace("_", " ") for name in recording.magnitude_names]
    with style():
        figure, axes = panels(len(names) + 1, 2.0)
        below = axes[-1]
        if not names:
            below.set_ylabel("force (N)")
            below.text(0.5, 0.5, "no contacts", transform=below.transAxes, ha="center")
            return figure
        desired, measured, true = (
            recording[key] for key in ("alpha_cmd", "alpha_meas", "alpha_true")
        )
        is_counted = _counting_mask(true.shape, judged)
        for i, (name, ax) in enumerate(zip(names, axes, strict=False)):
            ax.plot(t, desired[:, i], color="#B4BAC2", lw=5.0, label="desired")
            ax.plot(t, true[:, i], color=contact_colour(i), lw=1.8, label="true")
            ax.plot(t, measured[:, i], color="black", lw=0.9, ls=(0, (4, 6)), label="measured")
            ax.set(title=name, ylabel=rf"$\alpha_{{{i + 1}}}$ (N)")
            _shade(ax, t, is_counted[:, i])
            legend(ax)
        draw_errors(below, recording, judged)
        note = "" if is_counted.all() else " (shaded: not in rms and peak)"
        below.set_title(f"error: true − desired{note}")
    return figure


def draw_errors(
    ax: Axes, recording: Recording, judged: Judged | None = None, linear: float | None = None
) -> None:
    """Draw the errors of all forces over time, with their rms and peak values in the legend.

    Args:
        ax: axes, the lowest panel of `contact_forces`.
        recording: recording with the channels ``t``, ``alpha_cmd``, ``alpha_true``.
        judged: (T,) or (T, r) flags of the ticks that count, see `contact_forces`.
        linear: error (N) up to which the scale is linear, and logarithmic beyond; None: the
            largest judged error.
    """
    t = recording["t"]
    error = recording["alpha_true"] - recording["alpha_cmd"]
    is_counted = _counting_mask(error.shape, judged)
    for i, name in enumerate(recording.magnitude_names):
        counted_error = error[is_counted[:, i], i]
        sizes = f"rms {_si(_rms(counted_error))}N, peak {_si(_peak(counted_error))}N"
        label = f"{name.replace('_', ' ')}\n{sizes}"
        ax.plot(t, error[:, i], color=contact_colour(i), lw=0.9, label=label)
    ax.set_ylabel("error (N)")
    _shade(ax, t, np.asarray(is_counted.any(axis=1)))
    _scale_errors(ax, error, linear or _peak(error[is_counted]))
    legend(ax)


def power(recording: Recording, judged: Judged | None = None) -> Figure:
    """Figs. 6, 7: total power on top, projected power on the same scale, and that one enlarged.

    Args:
        recording: needs ``t``, ``power_total``, ``power_projected``.
        judged: (T,) True for the ticks that are judged (`judged_ticks`). The others are shaded, and
            left out of the rms values and of the enlarged scale. None: all are judged.

    Raises:
        RecordingError: a channel is missing.
    """
    t = recording["t"]
    total = recording["power_total"]
    projected = recording["power_projected"]
    is_counted = _counting_mask(total.shape, judged)
    of_total, of_projected = (f"rms {_si(_rms(x[is_counted]))}W" for x in (total, projected))
    total_limits = _limits(np.concatenate([total, projected]))
    # three panels: total power, projected power on the same scale, and enlarged
    contents = (
        (total, rf"total $\vartheta^T f'_{{meas}}$: {of_total}", "blue", total_limits),
        (
            projected,
            rf"projected $\vartheta^T \Omega_f f'_{{meas}}$: {of_projected}",
            "vermillion",
            total_limits,
        ),
        (projected, "projected, enlarged", "vermillion", _limits(projected[is_counted])),
    )
    with style():
        figure, axes = panels(3, 2.1)
        for ax, (series, title, colour, limits) in zip(axes, contents, strict=True):
            ax.plot(t, series, color=OKABE_ITO[colour], lw=0.9)
            ax.set(title=title, ylabel="power (W)", ylim=limits)
            _shade(ax, t, is_counted)
        if axes[0].patches:
            words = "not in the rms: settling, landings, force steps"
            axes[0].legend(
                [axes[0].patches[0]],
                [words],
                loc="lower right",
                bbox_to_anchor=(1.0, 1.0),
                borderaxespad=0.1,
            )
    return figure


def tracking(recording: Recording, judged_from: float = 0.0) -> Figure:
    """Projected motion error (mm and mrad) and the object's way from its start (mm).

    Args:
        recording: needs ``t``, ``motion_error``, ``pose``.
        judged_from: s; earlier times are shaded and left out of the rms values.

    Raises:
        RecordingError: a channel is missing.
    """
    t = recording["t"]
    error = 1e3 * recording["motion_error"]
    position = 1e3 * recording["pose"][:, :3]
    is_counted = _counting_mask(t.shape, t >= judged_from - 1e-9)
    contents = [(position - position[0], "object position, from its start", "position (mm)", "")]
    for part, quantity, kind, unit, about in (
        (error[:, 3:], "rotation", "angular", "mrad", "about "),
        (error[:, :3], "motion", "linear", "mm", ""),
    ):
        rms = _rms(np.linalg.norm(part[is_counted], axis=1))
        title = f"{quantity} error along the free directions: rms {rms:.3g} {unit}"
        contents.insert(0, (part, title, f"{kind} error ({unit})", about))
    with style():
        figure, axes = panels(3, 2.1)
        for ax, (series, title, unit, about) in zip(axes, contents, strict=True):
            ax.plot(t, series, label=[about + axis for axis in "xyz"])
            ax.set(title=title, ylabel=unit)
            _shade(ax, t, is_counted)
            legend(ax)
    return figure


def torques(recording: Recording) -> Figure:
    """Actuator efforts over time, one panel per arm: in percent of each motor's limit.

    Without limits in the recording: in N m, of sliding joints in N.

    Raises:
        RecordingError: a channel is missing.
    """
    t = recording["t"]
    tau = recording["tau"]
    limits = recording.meta["effort_limits"]
    names = list(limits)
    # columns of tau of each arm; names are arm/joint
    groups: dict[str, list[int]] = {}
    for i, name in enumerate(names):
        groups.setdefault(name.rpartition("/")[0], []).append(i)
    has_limits = all(limits.values())
    efforts = 100.0 * tau / np.array(list(limits.values())) if has_limits else tau
    with style():
        figure, axes = panels(len(groups), 2.6)
        for ax, (title, columns) in zip(axes, groups.items(), strict=True):
            peaks = [_peak(efforts[:, i]) for i in columns]
            for i, peak in zip(columns, peaks, strict=True):
                name = names[i].removeprefix(f"{title}/")
                label = f"{name}, peak {peak:.0f} %" if has_limits else name
                ax.plot(t, efforts[:, i], lw=0.9, label=label)
            unit = "% of its limit" if has_limits else "N m; sliding joints: N"
            ax.set(title=title.replace("_", " "), ylabel=f"effort ({unit})")
            if has_limits and max(peaks, default=0.0) > NEAR_LIMIT:
                for limit in (-100.0, 100.0):
                    ax.axhline(limit, color="black", lw=0.9, ls="--")
            legend(ax)
    return figure


def _counting_mask(shape: tuple[int, ...], judged: Judged | None) -> Judged:
    """Mask of the values that count for the scale of a plot: those judged, or all if none is.

    Args:
        shape: shape of the mask, (k,) or (k, columns), k ticks.
        judged: True where a value is judged, of a shape that broadcasts to `shape`; None: unknown.
    """
    mask = np.ones(shape, dtype=bool)
    return mask if judged is None or not judged.any() else judged & mask


def _shade(ax: Axes, t: Array, counted: Judged) -> None:
    """Shade the ticks that do not count."""
    edges = np.flatnonzero(np.diff(~counted, prepend=False, append=False))
    for start, stop in edges.reshape(-1, 2):
        end = t[min(stop, len(t) - 1)]
        ax.axvspan(t[start], end, color="#B8BDC4", alpha=0.6, lw=0)


def _scale_errors(ax: Axes, error: Array, linear: float) -> None:
    """Scale a vertical axis so that small errors are to scale, and large ones by their logarithm.

    Args:
        ax: axes of the plot.
        error: errors that are drawn, of any shape.
        linear: largest error that is drawn to scale, in the unit of the errors.
    """
    largest = _peak(error)
    if largest > 3.0 * linear > 0.0:
        ax.set_yscale("symlog", linthresh=linear, linscale=3.0)
        ax.set_ylim(-2.0 * largest, 2.0 * largest)
    else:
        ax.set_ylim(_limits(error))


def _peak(values: Array) -> float:
    """Largest absolute value, without NaN; 0 of no values."""
    return float(np.nanmax(np.abs(values), initial=0.0))


def _rms(values: Array) -> float:
    """Root mean square, without NaN; 0 of no finite values."""
    if not np.isfinite(values).any():
        return 0.0
    return float(np.sqrt(np.nanmean(np.square(values))))


def _limits(values: Array) -> tuple[float, float]:
    """Limits with 5 % air around the finite values; never an empty range."""
    finite = values[np.isfinite(values)]
    low, high = (finite.min(), finite.max()) if finite.size else (0.0, 0.0)
    air = 0.05 * (high - low) or 1e-3
    return (low - air, high + air)


def _si(value: float) -> str:
    """Value with three digits and the prefix m or µ where it helps; the unit follows it."""
    for factor, prefix in ((1.0, ""), (1e-3, "m"), (1e-6, "µ")):
        if value >= 0.9995 * factor:
            return f"{value / factor:.3g} {prefix}"
    return f"{value:.2g} "
