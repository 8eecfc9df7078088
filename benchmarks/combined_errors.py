"""Benchmark of the contact forces with all errors of a real workcell together.

    python -m benchmarks.combined_errors [--rigs two_contact_rod --rigs panda_edge] [--duration 4]
                                         [--dither]

All masses of the model 20 % too large or too small, 0.3 kg hidden in the object, friction of 0.2
believed to be 0.15, encoders and wrists with noise, wrists with 1 N of bias and 3 ms late, 500 Hz,
faces taken to be 3 mm nearer and turned by 3 deg, to four sides. Printed is a line for each rig,
mass and side: rms force error of each contact, what its reading errs by, how long it was closed.
"""

from itertools import product

import typer

import osc_contact as osc
from osc_contact.lab.sweeps.rows import without_logged_doubts
from paper.study import Data

#: Changes of any scenario, beside those of `judge`.
ERRORS = [
    "gains={}",
    "tare={}",
    "plant.friction=0.2",
    "model_error.hidden_mass=0.3 kg",
    "control={rate: 500 Hz, friction: {mu: 0.15}, force: {reading: least_squares}}",
    "model_error.face_offset=3 mm",
    "model_error.face_tilt=3 deg",
    "sensors.encoder={rate: 500 Hz, angle: {noise: 0.02 mrad}, length: {noise: 10 um}}",
    "sensors.wrist={rate: 500 Hz, delay: 3 ms, force: {noise: 0.1 N, bias: 1 N},"
    " torque: {noise: 0.005 Nm}}",
]
RIGS = ["two_contact_rod", "dual_panda_rod", "panda_edge"]
MASSES = (1.2, 0.8)
SIDES = (0, 90, 180, 270)


def judge(name: str, mass: float, side: float, duration: float = 4.0, dither: bool = False) -> Data:
    """The verdict (`metrics`) of a scenario with all errors.

    Args:
        name: name of the scenario.
        mass: factor on the controller's masses.
        side: deg, of the axis about which faces are turned.
        duration: s.
        dither: whether points show their normals first.
    """
    masses = [f"model_error.{of}={mass}" for of in ("arm_mass", "object_mass")]
    more = [f"model_error.face_tilt_about={side} deg", f"duration={duration} s"]
    more += ["control.dither={}"] * dither
    return osc.metrics(osc.run(osc.load_scenario(name, [*ERRORS, *masses, *more])))


def main(rigs: list[str] = RIGS, duration: float = 4.0, dither: bool = False) -> None:
    """Print the table."""
    print(f"{'rig':18}masses  side  force error, rms (reading)  closed  overshoot")
    for name, mass, side in product(rigs, MASSES, SIDES):
        with without_logged_doubts():
            verdict = judge(name, mass, side, duration, dither)
        forces = "  ".join(
            f"{one['rms_error_rel']:5.2%} ({one['sensing_rms_rel']:5.2%})"
            for one in verdict["force"].values()
        )
        closed = min(verdict["contact_fraction"].values())
        most = max(step["overshoot_rel"] for step in verdict["steps"])
        print(f"{name:18}{mass:6}{side:6}  {forces}  {closed:.2%}  {most:.0%}")


if __name__ == "__main__":
    typer.run(main)
