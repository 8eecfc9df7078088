"""Forces of an arm that touches a body which its model has elsewhere.

    python -m benchmarks.open_contact

A free motion leads a Panda's bar onto a table that its model has 30 mm lower: the contact counts as
open, no force is desired of it, and the motion (10 Hz, an integral time of 0.2 s) presses on until
a ceiling stops the arm. Columns: largest speed of the motion; largest true force, with the default
ceilings (30 N here), and with ceilings that are never reached.
"""

from __future__ import annotations

from rich.console import Console

import osc_contact as osc
from benchmarks.measuring import without_log
from osc_contact.contacts.feet import feet
from paper.study import table_of

SPEEDS = (0.015, 0.05, 0.1)  #: m/s
LOWER = 0.03  #: distance of the modelled table below the true one, and of the motion (m)
UNREACHED = "control.safety={wrist_ceiling: 10 kN, contact_ceiling: 10 kN}"


def pressed_from_the_air(speed: float, *changes: str) -> osc.Recording:
    """Recording of a bar that first rises, then goes down onto the table.

    Args:
        speed: largest speed of the way down (m/s).
        *changes: further changes of the scenario.
    """
    rig = osc.build_rig("panda_edge")
    down = feet(rig.pairs[0], rig.state.X_WO)[1][0]
    lasts = 1.875 * LOWER / speed  # of a motion of minimum jerk with this largest speed (s)
    moves = [
        {
            "kind": "linear",
            "direction": direction.tolist(),
            "signals": [{"type": "minimum_jerk", "value": way, "start": start, "duration": time}],
        }
        for direction, way, start, time in ((-down, 0.01, 0.05, 1.0), (down, LOWER, 1.3, lasts))
    ]
    stiff = "gains.motion={frequency: 10 Hz, integral_time: 0.2 s}"
    lower = f"model_error.face_offset={-LOWER} m"
    scenario = osc.load_scenario("panda_edge", [stiff, lower, *changes]).replaced(
        force={"edge": [{"type": "constant", "value": 0.0}]}, motion=moves, duration=1.75 + lasts
    )
    return osc.run(scenario)


def peak(speed: float, *changes: str) -> float:
    """Largest sum of the true contact forces (N).

    Args:
        speed: largest speed of the way down (m/s).
        *changes: further changes of the scenario.
    """
    return float(pressed_from_the_air(speed, *changes)["alpha_true"].sum(axis=1).max())


@without_log()
def main() -> None:
    """Print the table."""
    rows = [
        [f"{1e3 * speed:g}", f"{peak(speed):.0f}", f"{peak(speed, UNREACHED):.0f}"]
        for speed in SPEEDS
    ]
    heads = "speed (mm/s); peak (N); without ceilings (N)"
    Console(width=100).print(table_of("a table 30 mm higher than its model", heads, rows))


if __name__ == "__main__":
    main()
