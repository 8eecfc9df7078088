"""The report of a sweep: one page and its figures, beside the table.

It answers how many runs succeed, how large errors get, and what they depend on.
"""

import base64
import json
from collections import Counter
from collections.abc import Iterable, Mapping
from html import escape
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from osc_contact import __version__
from osc_contact.spatial import Array
from osc_contact.sweeps.study import SweepStudy
from osc_contact.visual.page import POLICY, asset, filled, write_whole

REPORT = "report.html"
SUMMARY = "summary.json"
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
        "errors": _errors(summary),
        "pictures": "".join(map(_picture, pictures)),
        "causes": _causes(summary),
        "shares": _shares(summary),
        "worst": "".join(map(_worst, summary["worst"])),
    }
    write_whole(filled("sweep.html", parts), folder / REPORT)
    return summary


def _about(study: SweepStudy, summary: Mapping[str, Any]) -> str:
    words = ", ".join(f"{count} {word}" for word, count in summary["words"].items())
    lists = ""
    for heading, keys in (("Varied", study.vary), ("Set in all runs", study.overrides)):
        items = "".join(f"<li><code>{escape(one)}</code></li>" for one in keys)
        lists += f"<p>{heading}:</p><ul>{items}</ul>" * bool(keys)
    return (
        f"<p><b>{summary['success_rate']:.1%}</b> of {summary['rows']} runs without a failed task: "
        f"{escape(words)}. Points: {study.design}, seed {study.seed}. osc_contact "
        f"{escape(__version__)}.</p>{lists}"
    )


def _errors(summary: Mapping[str, Any]) -> str:
    rows = (
        (name, *(f"{value:.3g}" for value in values.values()))
        for name, values in summary["quantiles"].items()
    )
    return _table(("error", "median", "90 %", "99 %", "largest"), rows)


def _causes(summary: Mapping[str, Any]) -> str:
    found = summary["sensitivities"]
    rows = (
        (error, *("" if rho is None else f"{rho:+.2f}" for rho in causes.values()))
        for error, causes in found.items()
    )
    return _table(("error", *next(iter(found.values()), {})), rows)


def _shares(summary: Mapping[str, Any]) -> str:
    """Sobol's indices of the design "saltelli"; nothing with others."""
    found = {error: shares for error, shares in summary["variances"].items() if shares}
    if not found:
        return ""
    rows = (
        (error, *(f"{s['first']:.0%} alone, {s['total']:.0%} in all" for s in shares.values()))
        for error, shares in found.items()
    )
    return (
        "<h3>Shares of the variance</h3><p>What each key makes of an error's variance alone, and "
        "in all with what it does together with others (Sobol's indices). With few samples they "
        'are rough, and a small one may come out negative.</p><div class="wide">'
        f"{_table(('error', *next(iter(found.values()))), rows)}</div>"
    )


def _worst(one: Mapping[str, Any]) -> str:
    value = "" if one["value"] is None else f", {escape(one['column'])} {one['value']:.3g}"
    why = f"<br>{escape(one['why'])}" if one["why"] else ""
    command = escape(one["command"] or "")
    command = f'<p class="command"><code>{command}</code></p>' * bool(command)
    return f"<p>Row {one['row']}: <b>{escape(one['word'])}</b>{value}{why}</p>{command}"


def _table(heads: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    lines = "".join(
        "<tr>" + "".join(f"<{cell}>{escape(text)}</{cell}>" for text in row) + "</tr>"
        for cell, row in (("th", heads), *(("td", row) for row in rows))
    )
    return f"<table>{lines}</table>"


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


# --- What the table contains --------------------------------------------------------------------

QUANTILES = (0.5, 0.9, 0.99, 1.0)
#: Ends of the columns in which errors stand, the most important first.
_ERRORS = (
    ".rms_error_rel",
    "overshoot_rel",
    "motion.rms_error_m",
    "motion.rms_error_rad",
    "power.ratio",
)


def summarise(table: Any, study: SweepStudy, worst: int = 5) -> dict[str, Any]:
    """Success rate, quantiles, sensitivities and the worst runs.

    Args:
        table: of `sweep`. study: of it. worst: how many of them are named.

    Returns:
        rows, success_rate, words {word: runs}, quantiles {column: {"50 %": …}}, sensitivities
        {column: {what varied: ρ}}, variances {column: {key: {first, total}}} of the design
        "saltelli", worst [{row, word, why, column, value, command}].
    """
    words = Counter(table.column("word").to_pylist())
    failed = table.column("failed").to_pylist()
    columns = judged_columns(table)
    return {
        "rows": table.num_rows,
        "success_rate": 1.0 - sum(failed) / max(1, len(failed)),
        "words": dict(words.most_common()),
        "quantiles": {
            name: {f"{100 * q:g} %": float(np.nanquantile(x, q)) for q in QUANTILES}
            for name in columns
            if np.isfinite(x := numbers(table, name)).any()
        },
        "sensitivities": {name: sensitivities(table, study, name) for name in columns},
        "variances": {name: variances(table, study, name) for name in columns},
        "worst": worst_rows(table, study, worst),
    }


def numbers(table: Any, name: str) -> Array:
    """(rows,) a column as numbers, NaN where there is none."""
    return np.array([np.nan if x is None else x for x in table.column(name).to_pylist()], float)


def judged_columns(table: Any) -> list[str]:
    """Names of the columns in which errors stand."""
    names = list(table.column_names)
    return [name for end in _ERRORS for name in names if name.endswith(end)]


def sensitivities(table: Any, study: SweepStudy, name: str) -> dict[str, float | None]:
    """Spearman's rank correlation of an error with everything that varied; None: not a number.

    Args:
        table: of the study, one row a run.
        study: names what varied.
        name: the column of the error.
    """
    from scipy.stats import spearmanr

    found: dict[str, float | None] = {}
    error = numbers(table, name)
    for column in study.sample(0).shown:
        found[column] = None
        if _varies(table, column):
            x = numbers(table, column)
            known = np.isfinite(x) & np.isfinite(error)
            if known.sum() > 2 and np.ptp(x[known]) > 0.0 and np.ptp(error[known]) > 0.0:
                found[column] = float(spearmanr(x[known], error[known]).statistic)
    return found


def variances(table: Any, study: SweepStudy, name: str) -> dict[str, dict[str, float]]:
    """Sobol's indices: which share of an error's variance each key makes, alone and with others.

    Args:
        table: of the design "saltelli". study: of it. name: column of the error.

    Returns:
        {key: {"first": alone, "total": with all that it works together with}}; empty with other
        designs, and where some row has no error.
    """
    f = numbers(table, name)
    if study.design != "saltelli" or len(f) != study.rows or not np.isfinite(f).all():
        return {}
    from scipy.stats import sobol_indices

    A, B, *AB = f.reshape(study.samples, -1).T
    parts = {"f_A": A[None], "f_B": B[None], "f_AB": np.array(AB)[:, None]}
    found = sobol_indices(func=parts, n=study.samples)
    shares = zip(np.ravel(found.first_order), np.ravel(found.total_order), strict=True)
    return {
        path: {"first": float(first), "total": float(total)}
        for (path, _), (first, total) in zip(study.variations, shares, strict=True)
    }


def worst_rows(table: Any, study: SweepStudy, count: int) -> list[dict[str, Any]]:
    """Runs that failed first, then those of the largest force errors, each with its command.

    Args:
        table: of the study, one row a run.
        study: gives the command that repeats a run.
        count: how many at most.
    """
    judged = [name for name in judged_columns(table) if name.endswith(".rms_error_rel")]
    found = []
    for row in table.to_pylist():
        errors = {name: row.get(name) or 0.0 for name in judged}
        name = max(judged, key=lambda name: errors[name], default=None)
        about = {key: row[key] for key in ("row", "word", "why")}
        value = None if name is None else row.get(name)
        badness = bool(row["failed"]), max(errors.values(), default=0.0)
        found.append((badness, about | {"column": name, "value": value}))
    found.sort(key=lambda one: one[0], reverse=True)
    return [one | {"command": study.command(one["row"])} for _, one in found[:count]]


def _varies(table: Any, name: str) -> bool:
    values = table.column(name).to_pylist()
    return all(isinstance(x, int | float) for x in values) and len(set(values)) > 1
