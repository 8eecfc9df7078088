"""Report of a sweep: a page with figures on success rate, errors, and their dependence on keys."""

from __future__ import annotations

import base64
import json
from collections import Counter
from collections.abc import Iterator
from html import escape
from importlib.util import find_spec
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from rich.console import Console
from rich.table import Table

from osc_contact import __version__
from osc_contact.files import Json, write_whole
from osc_contact.lab.sweeps.study import SweepStudy
from osc_contact.lab.visual.page import POLICY, asset, filled
from osc_contact.spatial import Array

if TYPE_CHECKING:
    import pyarrow

REPORT = "report.html"
SUMMARY = "summary.json"
_SHOWN = 4  #: largest number of errors that are drawn, and of causes of each
_WORST = 5  #: largest number of runs that are listed


def write_report(table: pyarrow.Table, study: SweepStudy, folder: Path) -> Json:
    """Write summary, figures (with the extra `plot`) and page; return the summary.

    Args:
        table: table of the runs, a row for each.
        study: study of the runs.
        folder: folder for the files.
    """
    summary = summarise(table, study)
    folder.mkdir(parents=True, exist_ok=True)
    write_whole(json.dumps(summary, indent=2, allow_nan=False), folder / SUMMARY)
    pictures = _draw(table, study, summary, folder) if find_spec("matplotlib") else ()
    parts = {
        "policy": POLICY,
        "style": asset("report.css"),
        "title": escape(Path(study.name or study.template.make().name).stem),
        "about": escape(f"{study.design}, seed {study.seed}; osc_contact {__version__}"),
        "changes": escape("\n".join((*study.vary, *study.overrides))),
        "text": escape(_printed_text(summary)),
        "pictures": "".join(map(_picture, pictures)),
    }
    write_whole(filled("sweep.html", parts), folder / REPORT)
    return summary


def in_words(summary: Json) -> Iterator[str | Table]:
    """Yield texts and a table to be printed: outcomes, errors and their causes, and the worst runs.

    Args:
        summary: result of `summarise`.
    """
    words = ", ".join(f"{count} {word}" for word, count in summary["words"].items())
    yield f"{summary['rows']} runs, {summary['success_rate']:.1%} without a failed task: {words}"
    table = Table(
        "error", "median", "90 %", "99 %", "largest", "depends most on (rank correlation)"
    )
    for name, values in summary["quantiles"].items():
        table.add_row(name, *(f"{value:.3g}" for value in values.values()), _causes(summary, name))
    if summary["quantiles"]:
        yield table
    for run in summary["worst"][:3]:
        value = "" if run["value"] is None else f", {run['column']} {run['value']:.3g}"
        command = f"\n  {run['command']}" if run["command"] else ""
        yield f"row {run['row']}: {run['word']}{value}{command}"


def _causes(summary: Json, name: str) -> str:
    """Text on the two keys that an error depends most on, by correlation and by variance.

    Args:
        summary: result of `summarise`.
        name: column of the error.
    """
    correlations = {
        key: rho for key, rho in summary["sensitivities"][name].items() if rho is not None
    }
    keys = sorted(correlations, key=lambda key: -abs(correlations[key]))[:2]
    text = ", ".join(f"{key} {correlations[key]:+.2f}" for key in keys)
    variances = summary["variances"][name].items()
    for key, share in sorted(variances, key=lambda entry: -entry[1]["total"])[:2]:
        text += f"\n{key}: {share['total']:.0%} of its variance, {share['first']:.0%} alone"
    return text


def _printed_text(summary: Json) -> str:
    """Text of `in_words`, as it is printed with a width of 160 letters.

    Args:
        summary: summary of a sweep.
    """
    console = Console(file=StringIO(), width=160)
    for part in in_words(summary):
        console.print(part, highlight=False, markup=False, soft_wrap=isinstance(part, str))
    return console.file.getvalue()  # type: ignore[attr-defined]


def _picture(path: Path) -> str:
    """HTML of a PNG file that is embedded in the page."""
    data = base64.b64encode(path.read_bytes()).decode("ascii")
    return (
        f'<figure><div class="wide"><img src="data:image/png;base64,{data}" '
        f'alt="{escape(path.stem)}"></div></figure>'
    )


def _draw(table: pyarrow.Table, study: SweepStudy, summary: Json, folder: Path) -> list[Path]:
    """Draw distributions of errors, and errors over varied values; return the PNG files.

    Args:
        table: table of the runs.
        study: study of the runs.
        folder: folder for the files.
        summary: summary of the table.
    """
    from matplotlib.figure import Figure

    from osc_contact.lab.visual.plots import save, style

    drawn_names = list(summary["quantiles"])[:_SHOWN]
    if not drawn_names:
        return []
    with style():
        # distribution of each error; a logarithmic axis needs positive values
        spread = Figure(figsize=(8.0, 3.4))
        ax = spread.subplots()
        for name in drawn_names:
            x = numbers(table, name)
            ax.ecdf(x[np.isfinite(x)], label=name)
        if all(summary["quantiles"][name]["50 %"] > 0.0 for name in drawn_names):
            ax.set_xscale("log")
        ax.set(title="Share of runs below an error", xlabel="error", ylabel="share of runs")
        ax.legend()
        pictures = [save(spread, folder / "errors")[0]]
        # each error over each key that varies, in a grid of panels
        causes = [n for n in study.sample(0).shown if _varies(table, n)][:_SHOWN]
        if causes:
            causes_figure = Figure(figsize=(8.0, 1.9 * len(drawn_names) + 0.4))
            axes = causes_figure.subplots(
                len(drawn_names), len(causes), squeeze=False, sharex="col", sharey="row"
            )
            for row, error in zip(axes, drawn_names, strict=True):
                for ax, cause in zip(row, causes, strict=True):
                    ax.plot(numbers(table, cause), numbers(table, error), ".", markersize=3)
                row[0].set_ylabel(error, fontsize=7)
            for ax, cause in zip(axes[-1], causes, strict=True):
                ax.set_xlabel(cause, fontsize=7)
            pictures.append(save(causes_figure, folder / "causes")[0])
    return pictures


# --- Summary of the table -----------------------------------------------------------------------

QUANTILES = (0.5, 0.9, 0.99, 1.0)
#: Ends of the names of columns with errors, the most important first.
_ERRORS = (
    ".rms_error_rel",
    "overshoot_rel",
    "motion.rms_error_m",
    "motion.rms_error_rad",
    "power.ratio",
)


def summarise(table: pyarrow.Table, study: SweepStudy) -> Json:
    """Success rate, quantiles, sensitivities and the worst runs.

    Args:
        table: table of the runs, a row for each.
        study: study of the runs.

    Returns:
        rows, success_rate, words {word: runs}, quantiles {column: {"50 %": …}}, sensitivities
        {column: {varied key: ρ}}, variances {column: {key: {first, total}}} of the design
        "saltelli", worst [{row, word, why, column, value, command}].
    """
    words = Counter(table.column("word").to_pylist())
    failed = table.column("failed").to_pylist()
    columns = judged_columns(table)
    quantiles = {}
    for name in columns:
        x = numbers(table, name)
        if np.isfinite(x).any():
            values = np.nanquantile(x, QUANTILES).tolist()
            quantiles[name] = {
                f"{100 * share:g} %": value for share, value in zip(QUANTILES, values, strict=True)
            }
    return {
        "rows": table.num_rows,
        "success_rate": 1.0 - sum(failed) / max(1, len(failed)),
        "words": dict(words.most_common()),
        "quantiles": quantiles,
        "sensitivities": {name: sensitivities(table, study, name) for name in columns},
        "variances": {name: variances(table, study, name) for name in columns},
        "worst": worst_rows(table, study),
    }


def numbers(table: pyarrow.Table, name: str) -> Array:
    """Column of a table as numbers (rows,), NaN for missing ones."""
    return np.array([np.nan if x is None else x for x in table.column(name).to_pylist()], float)


def judged_columns(table: pyarrow.Table) -> list[str]:
    """Names of the columns of errors."""
    return [name for end in _ERRORS for name in table.column_names if name.endswith(end)]


def sensitivities(table: pyarrow.Table, study: SweepStudy, name: str) -> dict[str, float | None]:
    """Spearman's rank correlation of an error with each varied column; None: not a number.

    Args:
        table: table of the runs.
        study: study of the runs.
        name: column of the error.
    """
    from scipy.stats import spearmanr

    correlations: dict[str, float | None] = dict.fromkeys(study.sample(0).shown)
    error = numbers(table, name)
    for column in correlations:
        if not _varies(table, column):
            continue
        pairs = np.array([numbers(table, column), error])
        pairs = pairs[:, np.isfinite(pairs).all(axis=0)]
        if pairs.shape[1] > 2 and np.ptp(pairs, axis=1).all():
            correlations[column] = float(spearmanr(*pairs).statistic)
    return correlations


def variances(table: pyarrow.Table, study: SweepStudy, name: str) -> dict[str, dict[str, float]]:
    """Sobol's indices: shares of an error's variance that keys cause, alone and with others.

    Args:
        table: table of the runs.
        study: study with the design "saltelli".
        name: column of the error.

    Returns:
        {key: {"first": alone, "total": with its interactions}}; empty for other designs, and if a
        row has no error.
    """
    f = numbers(table, name)
    if study.design != "saltelli" or len(f) != study.rows or not np.isfinite(f).all():
        return {}
    from scipy.stats import sobol_indices

    A, B, *AB = f.reshape(study.samples, -1).T
    parts = {"f_A": A[None], "f_B": B[None], "f_AB": np.array(AB)[:, None]}
    indices = sobol_indices(func=parts, n=study.samples)
    first = np.ravel(indices.first_order).tolist()
    total = np.ravel(indices.total_order).tolist()
    return {
        path: {"first": first[k], "total": total[k]} for k, (path, _) in enumerate(study.variations)
    }


def worst_rows(table: pyarrow.Table, study: SweepStudy) -> list[Json]:
    """Runs that failed, then those with the largest force errors, with commands to repeat them.

    Args:
        table: table of the runs.
        study: study of the runs.
    """
    judged = [name for name in judged_columns(table) if name.endswith(".rms_error_rel")]
    row_order = []  # whether the run failed, its largest error, and its description
    for row in table.to_pylist():
        errors = {name: row[name] or 0.0 for name in judged}
        name = max(judged, key=errors.__getitem__, default=None)
        about = {key: row[key] for key in ("row", "word", "why")}
        about |= {"column": name, "value": name and row[name]}
        row_order.append((row["failed"], max(errors.values(), default=0.0), about))
    row_order.sort(key=lambda entry: entry[:2], reverse=True)
    selected = [about for _, _, about in row_order[:_WORST]]
    return [about | {"command": study.command(about["row"])} for about in selected]


def _varies(table: pyarrow.Table, name: str) -> bool:
    """Return whether a column has different numbers."""
    values = table.column(name).to_pylist()
    return all(isinstance(x, int | float) for x in values) and len(set(values)) > 1
