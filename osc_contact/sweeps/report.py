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
from osc_contact.files import write_whole
from osc_contact.spatial import Array
from osc_contact.sweeps.study import SweepStudy
from osc_contact.visual.page import POLICY, asset, filled

REPORT = "report.html"
SUMMARY = "summary.json"
_SHOWN = 4  #: errors that are drawn; as many causes of each
_WORST = 5  #: runs that are named


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
    errors = {
        error: [f"{value:.3g}" for value in found.values()]
        for error, found in summary["quantiles"].items()
    }
    causes = {
        error: ["" if rho is None else f"{rho:+.2f}" for rho in found.values()]
        for error, found in summary["sensitivities"].items()
    }
    parts = {
        "policy": POLICY,
        "style": asset("report.css"),
        "title": escape(title),
        "about": _about(study, summary),
        "errors": _table(("median", "90 %", "99 %", "largest"), errors),
        "pictures": "".join(map(_picture, pictures)),
        "causes": _table(study.sample(0).shown, causes),
        "shares": _shares(study, summary),
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


def _shares(study: SweepStudy, summary: Mapping[str, Any]) -> str:
    """Sobol's indices of the design "saltelli"; nothing with others."""
    rows = {
        error: [f"{s['first']:.0%} alone, {s['total']:.0%} in all" for s in found.values()]
        for error, found in summary["variances"].items()
        if found
    }
    text = (
        "<h3>Shares of the variance</h3><p>What each key makes of an error's variance alone, and "
        "in all with what it does together with others (Sobol's indices). With few samples they "
        'are rough, and a small one may come out negative.</p><div class="wide">'
        f"{_table([path for path, _ in study.variations], rows)}</div>"
    )
    return text * bool(rows)


def _worst(one: Mapping[str, Any]) -> str:
    value = "" if one["value"] is None else f", {escape(one['column'])} {one['value']:.3g}"
    why = f"<br>{escape(one['why'])}" if one["why"] else ""
    command = escape(one["command"] or "")
    command = f'<p class="command"><code>{command}</code></p>' * bool(command)
    return f"<p>Row {one['row']}: <b>{escape(one['word'])}</b>{value}{why}</p>{command}"


def _table(heads: Iterable[str], rows: Mapping[str, Iterable[str]]) -> str:
    lines = [("th", "error", heads), *(("td", error, cells) for error, cells in rows.items())]
    text = ""
    for kind, *cells in ((kind, error, *cells) for kind, error, cells in lines):
        text += "<tr>" + "".join(f"<{kind}>{escape(cell)}</{kind}>" for cell in cells) + "</tr>"
    return f"<table>{text}</table>"


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
            x = numbers(table, name)
            ax.ecdf(x[np.isfinite(x)], label=name)
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


def summarise(table: Any, study: SweepStudy) -> dict[str, Any]:
    """Success rate, quantiles, sensitivities and the worst runs.

    Args:
        table: of `sweep`. study: of it.

    Returns:
        rows, success_rate, words {word: runs}, quantiles {column: {"50 %": …}}, sensitivities
        {column: {what varied: ρ}}, variances {column: {key: {first, total}}} of the design
        "saltelli", worst [{row, word, why, column, value, command}].
    """
    words = Counter(table.column("word").to_pylist())
    failed = table.column("failed").to_pylist()
    columns = judged_columns(table)
    quantiles = {}
    for name in columns:
        x = numbers(table, name)
        if np.isfinite(x).any():
            found = np.nanquantile(x, QUANTILES).tolist()
            quantiles[name] = {f"{100 * q:g} %": v for q, v in zip(QUANTILES, found, strict=True)}
    return {
        "rows": table.num_rows,
        "success_rate": 1.0 - sum(failed) / max(1, len(failed)),
        "words": dict(words.most_common()),
        "quantiles": quantiles,
        "sensitivities": {name: sensitivities(table, study, name) for name in columns},
        "variances": {name: variances(table, study, name) for name in columns},
        "worst": worst_rows(table, study),
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

    found: dict[str, float | None] = dict.fromkeys(study.sample(0).shown)
    error = numbers(table, name)
    for column in filter(lambda column: _varies(table, column), found):
        both = np.array([numbers(table, column), error])
        both = both[:, np.isfinite(both).all(axis=0)]
        if both.shape[1] > 2 and np.ptp(both, axis=1).all():
            found[column] = float(spearmanr(*both).statistic)
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
    first, total = (np.ravel(x).tolist() for x in (found.first_order, found.total_order))
    return {
        path: {"first": first[k], "total": total[k]} for k, (path, _) in enumerate(study.variations)
    }


def worst_rows(table: Any, study: SweepStudy) -> list[dict[str, Any]]:
    """Runs that failed first, then those of the largest force errors, each with its command.

    Args:
        table: of the study, one row a run.
        study: gives the command that repeats a run.
    """
    judged = [name for name in judged_columns(table) if name.endswith(".rms_error_rel")]
    found = []
    for row in table.to_pylist():
        errors = {name: row[name] or 0.0 for name in judged}
        name = max(judged, key=errors.__getitem__, default=None)
        about = {key: row[key] for key in ("row", "word", "why")}
        about |= {"column": name, "value": name and row[name]}
        found.append((row["failed"], max(errors.values(), default=0.0), about))
    found.sort(key=lambda one: one[:2], reverse=True)
    return [one | {"command": study.command(one["row"])} for *_, one in found[:_WORST]]


def _varies(table: Any, name: str) -> bool:
    values = table.column(name).to_pylist()
    return all(isinstance(x, int | float) for x in values) and len(set(values)) > 1
