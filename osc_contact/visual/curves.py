"""What the page plots below its scene: contact forces and power over time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from osc_contact.recorder import column_names
from osc_contact.visual import OKABE_ITO, contact_colour

__all__ = ["layout", "thinned", "values"]

Array = NDArray[np.float64]
_FORCES = (("alpha_cmd", "pale"), ("alpha_true", "solid"), ("alpha_meas", "dashed"))
_POWERS = (
    ("power_total", "#8A919C", "solid", "total"),
    ("power_projected", OKABE_ITO["purple"], "solid", "projected by Ω_f"),
)


def layout(
    sample: Mapping[str, Any], contacts: list[str], columns: Sequence[int] = ()
) -> list[dict[str, Any]]:
    """The panels and their lines, for what was recorded; JSON-able.

    Args:
        sample: the channels at one tick; what is missing has no panel.
        contacts: their names.
        columns: the contact of each force (default: one force per contact).
    """
    owners = list(columns) or list(range(len(contacts)))
    names = column_names(contacts, owners if contacts else ())
    forces = [
        {"key": key, "index": i, "look": look,
         "colour": contact_colour(owners[i]) if look != "dashed" else "#15181C",
         "name": name.replace("_", " ") if look == "solid" else ""}
        for key, look in _FORCES if key in sample
        for i, name in enumerate(names[: np.size(sample[key])])
    ]  # fmt: skip
    powers = [
        {"key": key, "index": -1, "colour": colour, "look": look, "name": name}
        for key, colour, look, name in _POWERS
        if key in sample
    ]
    panels = [
        {
            "title": "contact force",
            "unit": "N",
            "lines": forces,
            "note": "wide: commanded, solid: true, dashed: measured",
        },
        {
            "title": "power",
            "unit": "W",
            "lines": powers,
            "note": "of the measured wrench, in the motion relative to the faces",
        },
    ]
    return [panel for panel in panels if panel["lines"]]


def values(panels: list[dict[str, Any]], sample: Mapping[str, Any]) -> list[float | None]:
    """The numbers of all lines at one tick, in the order of the panels."""
    return [_number(v) for v in _columns(panels, sample)]


def thinned(
    panels: list[dict[str, Any]], channels: Mapping[str, Any], bins: int = 450
) -> dict[str, Any]:
    """Times and values of all lines: the smallest and largest value of each of `bins` stretches.

    Short peaks stay visible this way, however long the recording is.

    Args:
        panels: from `layout`.
        channels: (T, …) of each channel, and the times `t` (T,).
        bins: stretches of equally many ticks.
    """
    t = np.asarray(channels["t"], dtype=float)
    rows = [np.asarray(row, dtype=float) for row in _columns(panels, channels)]
    if len(t) <= 2 * bins:
        return {"t": _times(t), "y": [_numbers(row) for row in rows]}
    edges = np.linspace(0, len(t), bins + 1).astype(int)
    parts = list(pairwise(edges))
    times = [moment for a, b in parts for moment in (t[a], t[b - 1])]
    thin = []
    for row in rows:
        pairs = []
        for a, b in parts:
            part = np.nan_to_num(row[a:b])
            low, high = int(part.argmin()), int(part.argmax())
            pairs += [part[min(low, high)], part[max(low, high)]]
        thin.append(_numbers(pairs))
    return {"t": _times(times), "y": thin}


def _columns(panels: list[dict[str, Any]], channels: Mapping[str, Any]) -> list[Any]:
    lines = [line for panel in panels for line in panel["lines"]]
    return [
        channels[line["key"]] if line["index"] < 0 else channels[line["key"]][..., line["index"]]
        for line in lines
    ]


def _times(row: ArrayLike) -> list[float]:
    return [round(float(t), 4) for t in np.asarray(row)]


def _numbers(row: ArrayLike) -> list[float | None]:
    return [_number(v) for v in np.asarray(row, dtype=float)]


def _number(value: Any) -> float | None:
    """Four significant digits; JSON knows no NaN."""
    number = float(value)
    return float(f"{number:.4g}") if np.isfinite(number) else None
