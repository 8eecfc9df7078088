"""The report of a sweep: one page and its figures, beside the table."""

from __future__ import annotations

import base64
import json
from collections.abc import Iterable, Mapping
from html import escape
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from osc_contact import __version__
from osc_contact.sweeps.study import SweepStudy
from osc_contact.sweeps.summary import numbers, summarise
from osc_contact.visual.page import POLICY, asset, filled, write_whole

__all__ = ["REPORT", "SUMMARY", "write_report"]

REPORT, SUMMARY = "report.html", "summary.json"
_SHOWN = 4  #: errors that are drawn; as many causes of each


def write_report(table: Any, study: SweepStudy, folder: Path) -> dict[str, Any]:
    """Write summary, figures (with the extra `plot`) and page; returns the summary.

    Args:
        table: of `sweep`. study: of it. folder: for the files.
    """
    summary = summarise(table, study)
    folder.mkdir(parents=True, exist_ok=True)
    write_whole(json.dumps(summary, indent=2, allow_nan=False), folder / SUMMARY)
    pictures = _draw(table, study, summary, folder) if find_spec("matplotlib") else ()
    title = f"{Path(study.name or study.template.make().name).stem}: {summary['rows']} runs"
    parts = {
        "policy": POLICY,
        "style": asset("report.css"),
        "title": escape(title),
        "about": _about(study, summary),
        "errors": _rows(("error", "median", "90 %", "99 %", "largest"), _errors(summary)),
        "pictures": "".join(map(_picture, pictures)),
        "causes": _causes(summary),
        "shares": _shares(summary),
        "worst": "".join(map(_worst, summary["worst"])),
    }
    write_whole(filled("sweep.html", parts), folder / REPORT)
    return summary


def _about(study: SweepStudy, summary: Mapping[str, Any]) -> str:
    words = ", ".join(f"{count} {word}" for word, count in summary["words"].items())
    varied = "".join(f"<li><code>{escape(one)}</code></li>" for one in study.vary)
    fixed = "".join(f"<li><code>{escape(one)}</code></li>" for one in study.overrides)
    return (
        f"<p><b>{summary['success_rate']:.1%}</b> of {summary['rows']} runs without a failed task: "
        f"{escape(words)}. Points: {study.design}, seed {study.seed}. osc_contact "
        f"{escape(__version__)}.</p><p>Varied:</p><ul>{varied}</ul>"
        + (f"<p>Set in all runs:</p><ul>{fixed}</ul>" if fixed else "")
    )


def _errors(summary: Mapping[str, Any]) -> Iterable[tuple[str, ...]]:
    for name, values in summary["quantiles"].items():
        yield (name, *(f"{value:.3g}" for value in values.values()))


def _causes(summary: Mapping[str, Any]) -> str:
    names = list(next(iter(summary["sensitivities"].values()), {}))
    rows = [
        (error, *("" if found[n] is None else f"{found[n]:+.2f}" for n in names))
        for error, found in summary["sensitivities"].items()
    ]
    return _rows(("error", *names), rows)


def _shares(summary: Mapping[str, Any]) -> str:
    """Sobol's indices of the design "saltelli"; nothing with others."""
    found = {error: shares for error, shares in summary["variances"].items() if shares}
    if not found:
        return ""
    rows = [
        (error, *(f"{s['first']:.0%} alone, {s['total']:.0%} in all" for s in shares.values()))
        for error, shares in found.items()
    ]
    return (
        "<h3>Shares of the variance</h3><p>What each key makes of an error's variance alone, and "
        "in all with what it does together with others (Sobol's indices). With few samples they "
        'are rough, and a small one may come out negative.</p><div class="wide">'
        f"{_rows(('error', *next(iter(found.values()))), rows)}</div>"
    )


def _worst(one: Mapping[str, Any]) -> str:
    value = "" if one["value"] is None else f", {escape(one['column'])} {one['value']:.3g}"
    why = f"<br>{escape(one['why'])}" if one["why"] else ""
    command = f'<p class="command"><code>{escape(one["command"])}</code></p>' * bool(one["command"])
    return f"<p>Row {one['row']}: <b>{escape(one['word'])}</b>{value}{why}</p>{command}"


def _rows(heads: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    head = "".join(f"<th>{escape(text)}</th>" for text in heads)
    body = "".join(
        "<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows
    )
    return f"<table><tr>{head}</tr>{body}</table>"


def _picture(path: Path) -> str:
    data = base64.b64encode(path.read_bytes()).decode("ascii")
    return (
        f'<figure><div class="wide"><img src="data:image/png;base64,{data}" '
        f'alt="{escape(path.stem)}"></div></figure>'
    )


def _draw(table: Any, study: SweepStudy, summary: Mapping[str, Any], folder: Path) -> list[Path]:
    """How errors are distributed, and over what they depend on; PNG and SVG."""
    from matplotlib.figure import Figure

    from osc_contact.visual.plots import save, style

    shown = list(summary["quantiles"])[:_SHOWN]
    if not shown:
        return []
    with style():
        spread = Figure(figsize=(8.0, 3.4))
        ax = spread.subplots()
        for name in shown:
            x = np.sort(numbers(table, name))
            x = x[np.isfinite(x)]
            ax.step(x, (np.arange(len(x)) + 1) / len(x), where="post", label=name)
        if all(summary["quantiles"][name]["50 %"] > 0.0 for name in shown):
            ax.set_xscale("log")
        ax.set(title="Share of runs below an error", xlabel="error", ylabel="share of runs")
        ax.legend()
        written = [save(spread, folder / "errors")[0]]
        causes = [n for n in study.sample(0).shown if _varies(table, n)][:_SHOWN]
        if causes:
            over = Figure(figsize=(8.0, 1.9 * len(shown) + 0.4))
            axes = over.subplots(len(shown), len(causes), squeeze=False, sharex="col", sharey="row")
            for row, error in zip(axes, shown, strict=True):
                for ax, cause in zip(row, causes, strict=True):
                    ax.plot(numbers(table, cause), numbers(table, error), ".", markersize=3)
                row[0].set_ylabel(error, fontsize=7)
            for ax, cause in zip(axes[-1], causes, strict=True):
                ax.set_xlabel(cause, fontsize=7)
            written.append(save(over, folder / "causes")[0])
    return written


def _varies(table: Any, name: str) -> bool:
    values = table.column(name).to_pylist()
    return all(isinstance(x, int | float) for x in values) and len(set(values)) > 1
