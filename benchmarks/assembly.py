"""Pegs into holes beside the modelled ones: successes, times and peak forces.

    python -m benchmarks.assembly [--count 10] [--seed 1000] [--peg square|round|two_pins]

A Panda inserts a peg of 20 mm into a hole, 30 mm deep, that is displaced by up to `offset` along
each axis and by up to `tilt` about each axis, unknown to the plan; its clearance is known within
20 µm. With `two_pins`, two Pandas insert both pins of a bar, 240 mm apart, into two such holes of
one block, which is displaced about its middle. Clearance, offset and tilt are 0.2 mm, 2 mm and 2
degrees, of two pins 0.3 mm, 1 mm and 1 degree, unless given.

Wrist noise 0.2 N and 10 mN m, encoders of 18 bits, joint friction of 1 %, friction 0.2 of the
holes, masses wrong by up to 5 %, default safety with a ceiling of 100 N. MuJoCo's contacts have
solref (3 ms, 1) and solimp (0.6, 0.95, 0.2 mm), some 350 N/mm. One row for each seed, then the
shares and quantiles. Peaks are those of the sum of all contact forces, and of a single contact, at
the end of each millisecond; the mean is that of the norm of this sum, while anything touches.
"""

from collections.abc import Callable, Mapping

import numpy as np
import typer
from rich.console import Console

from benchmarks.measuring import without_log
from osc_contact.contacts.insertion import Peg
from osc_contact.lab.tasks.insertion import WIDTH, Insertion
from osc_contact.lab.tasks.pegs import Inserted, insert
from osc_contact.lab.tasks.two_pin_plan import insert_both
from osc_contact.lab.tasks.two_pins import TwoPins

#: Clearance (mm), offset (mm) and tilt (degrees) of each kind of peg.
DEFAULTS = {"square": (0.2, 2.0, 2.0), "round": (0.2, 2.0, 2.0), "two_pins": (0.3, 1.0, 1.0)}


def summary(results: list[Inserted]) -> str:
    """Shares and quantiles of some results."""
    if not results:
        return "0 of 0"
    done = [one for one in results if one.success]
    times = np.array([one.time for one in done])
    sums = np.array([one.largest_sum for one in results])
    singles = np.array([one.largest_single for one in results])
    means = np.array([one.mean_sum for one in results])
    text = f"{len(done)} of {len(results)}"
    if done:
        text += f"; time of these: median {np.median(times):.1f} s"
    return (
        f"{text}; peak of the sum: median {np.median(sums):.0f} N, 95 % "
        f"{np.quantile(sums, 0.95):.0f} N; of a single contact: median {np.median(singles):.0f} N, "
        f"95 % {np.quantile(singles, 0.95):.0f} N; mean of the sum: median {np.median(means):.1f} N"
    )


def row_of(seed: int, one: Inserted) -> str:
    """Row of one insertion.

    Args:
        seed: seed of the insertion.
        one: result of the insertion.
    """
    words = "in" if one.success else f"not in: {one.reason[:60] or 'not seated'}"
    return (
        f"{seed}: {one.time:.1f} s, {one.tries} tries, {1e3 * one.depth:.1f} mm deep, "
        f"{np.degrees(one.tilt):.2f}°, {one.largest_sum:.0f} N, single "
        f"{one.largest_single:.0f} N, mean {one.mean_sum:.1f} N, {words}"
    )


@without_log()
def compare(
    laws: Mapping[str, Callable[[int], Inserted]], count: int, seed: int, only: str
) -> None:
    """Print one row for each seed and law, and a summary of each law.

    Args:
        laws: functions that make the insertion of a seed, by the name of their law.
        count: number of seeds.
        seed: first seed.
        only: laws whose name contains this.
    """
    console = Console(width=140, highlight=False)
    results: dict[str, list[Inserted]] = {name: [] for name in laws if only in name}
    for k in range(seed, seed + count):
        for name, of_law in results.items():
            of_law.append(laws[name](k))
            console.print(f"{name}, {row_of(k, of_law[-1])}", soft_wrap=True)
    for name, of_law in results.items():
        console.print(f"{name}: {summary(of_law)}", soft_wrap=True)


@without_log()
def main(
    count: int = 10,
    seed: int = 1000,
    peg: str = "square",
    clearance: float | None = None,
    offset: float | None = None,
    tilt: float | None = None,
) -> None:
    """Print the table; clearance and offset in mm, tilt in degrees."""
    if peg not in DEFAULTS:
        raise typer.BadParameter(f"{peg!r}; give {', '.join(DEFAULTS)}", param_hint="--peg")
    given = (clearance, offset, tilt)
    sizes = [own if one is None else one for own, one in zip(DEFAULTS[peg], given, strict=True)]
    console = Console(width=140, highlight=False)
    results = []
    for k in range(seed, seed + count):
        one = inserted(peg, k, 1e-3 * sizes[0], 1e-3 * sizes[1], float(np.radians(sizes[2])))
        results.append(one)
        console.print(row_of(k, one), soft_wrap=True)
    console.print(summary(results), soft_wrap=True)


def inserted(peg: str, seed: int, clearance: float, offset: float, tilt: float) -> Inserted:
    """Result of one insertion.

    Args:
        peg: key of `DEFAULTS`.
        seed: seed of everything random.
        clearance: width of the hole less that of the peg (m).
        offset: largest displacement along each axis (m).
        tilt: largest displacement about each axis (rad).
    """
    if peg == "two_pins":
        return insert_both(TwoPins(seed, clearance, offset, tilt))
    shape = Peg("round" if peg == "round" else "square", WIDTH)
    return insert(Insertion(shape, clearance, seed, offset, tilt))


if __name__ == "__main__":
    typer.run(main)
