"""What a study's table says: how many runs succeed, how large errors get, what they depend on."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np

from osc_contact.spatial import Array
from osc_contact.sweeps.study import SweepStudy

__all__ = ["QUANTILES", "judged_columns", "sensitivities", "summarise", "variances", "worst_rows"]

QUANTILES = (0.5, 0.9, 0.99, 1.0)
#: Ends of the columns in which errors stand, most telling first.
_ERRORS = (".rms_error_rel", "overshoot_rel", "motion.rms_error_m", "motion.rms_error_rad",
           "power.ratio")  # fmt: skip


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
        study: says what varied.
        name: the column of the error.
    """
    from scipy.stats import spearmanr

    found: dict[str, float | None] = {}
    error = numbers(table, name)
    for column in study.sample(0).shown:
        if not all(isinstance(x, int | float) for x in table.column(column).to_pylist()):
            found[column] = None
            continue
        x = numbers(table, column)
        known = np.isfinite(x) & np.isfinite(error)
        varied = known.sum() > 2 and np.ptp(x[known]) > 0.0 and np.ptp(error[known]) > 0.0
        found[column] = float(spearmanr(x[known], error[known]).statistic) if varied else None
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
    both = zip(np.atleast_1d(found.first_order), np.atleast_1d(found.total_order), strict=True)
    keys = [path for path, _ in study.variations]
    return {
        key: {"first": float(first), "total": float(total)}
        for key, (first, total) in zip(keys, both, strict=True)
    }


def worst_rows(table: Any, study: SweepStudy, count: int) -> list[dict[str, Any]]:
    """Runs that failed first, then those of the largest force errors, each with its command.

    Args:
        table: of the study, one row a run.
        study: says how a run is repeated.
        count: how many at most.
    """
    rows = table.to_pylist()
    judged = [name for name in judged_columns(table) if name.endswith(".rms_error_rel")]

    def badness(row: dict[str, Any]) -> tuple[bool, float]:
        return bool(row["failed"]), max((row.get(name) or 0.0 for name in judged), default=0.0)

    found = []
    for row in sorted(rows, key=badness, reverse=True)[:count]:
        name = max(judged, key=lambda n: row.get(n) or 0.0, default=None)
        found.append({
            "row": row["row"],
            "word": row["word"],
            "why": row["why"],
            "column": name,
            "value": None if name is None else row.get(name),
            "command": study.command(row["row"]),
        })  # fmt: skip
    return found
