"""A peg into a hole beside the modelled one: successes, times and peak forces.

    python -m benchmarks.assembly [--count 10] [--seed 1000] [--peg round]

A Panda inserts a peg of 20 mm into a hole, 30 mm deep, that is displaced by up to `offset` along
each axis and by up to `tilt` about each axis, unknown to the plan; its clearance is known within
20 µm. Wrist noise 0.2 N and 10 mN m, encoders of 18 bits, joint friction of 1 %, friction 0.2 of
the hole, masses wrong by up to 5 %, default safety with a ceiling of 100 N. MuJoCo's
contacts have solref (3 ms, 1) and solimp (0.6, 0.95, 0.2 mm), some 350 N/mm. One row for each seed,
then the shares and quantiles. Peaks are those of the sum of all contact forces, and of a single
contact, at the end of each millisecond.
"""

import logging

import numpy as np
import typer
from rich.console import Console

from osc_contact.contacts.insertion import Peg
from osc_contact.lab.tasks.insertion import WIDTH, Insertion
from osc_contact.lab.tasks.pegs import Inserted, insert


def summary(results: list[Inserted]) -> str:
    """Shares and quantiles of some results."""
    done = [one for one in results if one.success]
    times = np.array([one.time for one in done])
    sums = np.array([one.largest_sum for one in results])
    singles = np.array([one.largest_single for one in results])
    text = f"{len(done)} of {len(results)}"
    if done:
        text += f"; time of these: median {np.median(times):.1f} s"
    return (
        f"{text}; peak of the sum: median {np.median(sums):.0f} N, 95 % "
        f"{np.quantile(sums, 0.95):.0f} N; of a single contact: median {np.median(singles):.0f} N, "
        f"95 % {np.quantile(singles, 0.95):.0f} N"
    )


def main(
    count: int = 10,
    seed: int = 1000,
    clearance: float = 0.2,
    offset: float = 2.0,
    tilt: float = 2.0,
    peg: str = "square",
) -> None:
    """Print the table; clearance and offset in mm, tilt in degrees."""
    if peg not in ("square", "round"):
        raise typer.BadParameter(f"{peg!r}; give square or round", param_hint="--peg")
    logging.disable(logging.WARNING)
    console = Console(width=140, highlight=False)
    results = []
    for k in range(seed, seed + count):
        shape = Peg(peg, WIDTH)  # type: ignore[arg-type]  # one of the two, as checked
        task = Insertion(shape, 1e-3 * clearance, k, 1e-3 * offset, float(np.radians(tilt)))
        one = insert(task)
        results.append(one)
        words = "in" if one.success else f"not in: {one.reason[:60] or 'not seated'}"
        console.print(
            f"{k}: {one.time:.1f} s, {one.tries} tries, {1e3 * one.depth:.1f} mm deep, "
            f"{np.degrees(one.tilt):.2f}°, {one.largest_sum:.0f} N, single "
            f"{one.largest_single:.0f} N, {words}",
            soft_wrap=True,
        )
    console.print(summary(results), soft_wrap=True)


if __name__ == "__main__":
    typer.run(main)
