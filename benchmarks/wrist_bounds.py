"""The smallest errors of wrists that motors contradict: what `wrist_error` is in newtons.

    python benchmarks/wrist_bounds.py

A wrist that is wrong by Δw leaves |column_j · Δw| of the torque of each joint j inboard of it
unexplained, and is found wrong above `wrist_error` of the limit of some joint's motor. An error ΔF
of the force of one contact, all of it read by one wrist, therefore is found above

    ΔF = min_j wrist_error τ_max,j / |column_j · N|.

A wrist that reads s F of a force F is off by (1 − s) F: it is found below s = 1 − ΔF/F, and never
where F is below ΔF. The force law holds what is read at its command: without this rule the true
force may be off by as much. Printed for the start of each packaged scenario with contacts are the
least and the largest ΔF of its wrists and contacts, the largest force that is commanded, and the s
below which a wrist is found wrong for the contact where ΔF is least and where it is largest.
"""

from __future__ import annotations

import numpy as np
import typer
from rich.console import Console

import osc_contact as osc
from osc_contact.spatial import Array
from paper.study import table_of

PERIOD = 0.01  #: s between the commands that are looked at


def smallest_errors(rig: osc.Rig) -> Array:
    """ΔF (arms, columns of N) in newtons; inf: no joint with a motor sees it."""
    chain = rig.model
    share = rig.scenario.control.safety.wrist_error
    limits = np.full(chain.nq, np.inf)
    limits[list(chain.actuated)] = chain.tau_max
    rows = []
    first = 0
    for terms in rig.state.arms:
        end = first + terms.J.shape[1]
        torques = np.abs(terms.J.T @ rig.contact.N)
        with np.errstate(divide="ignore"):
            rows.append((share * limits[first:end, None] / torques).min(axis=0))
        first = end
    return np.array(rows)


def found_below(force: float, error: float) -> str:
    """The scale below which a wrist is found wrong."""
    return f"{1.0 - error / force:.2f}" if force > error else "never"


def main() -> None:
    """Print the table."""
    rows = []
    for name in osc.list_scenarios():
        scenario = osc.load_scenario(name)
        if not scenario.contacts:
            continue
        rig = osc.build_rig(scenario)
        errors = smallest_errors(rig)
        times = np.arange(0.0, scenario.duration, PERIOD)
        force = max(np.abs(rig.references.at(t).alpha_d).max() for t in times)
        least, most = float(errors.min()), float(errors.max())
        scales = (found_below(force, least), found_below(force, most))
        rows.append((name, f"{least:.1f}", f"{most:.1f}", f"{force:.1f}", *scales))
    columns = "scenario; least ΔF (N); largest; command (N); found below s, least; largest"
    Console(width=120).print(table_of("", columns, rows))


if __name__ == "__main__":
    typer.run(main)
