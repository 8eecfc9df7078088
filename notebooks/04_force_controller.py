# ---
# jupyter:
#   jupytext:
#     formats: py:percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # Design your own force controller
#
# Fig. 4 shows the controller as boxes with named signals between them. Three laws can be replaced
# by custom functions (`osc_contact.Laws`), while the rest of the tick stays compiled: the
# motion law, the control structure, and here the force law, which turns desired and measured
# magnitudes into commanded ones. The filters behind it keep its commands out of the motion,
# whatever they are. So a force law can be designed separately.

# %%
# %matplotlib inline
import numpy as np
from matplotlib import pyplot as plt

import osc_contact as osc
from osc_contact.control.custom_laws import force_law
from osc_contact.lab.visual import contact_colour, plots
from osc_contact.lab.visual.plots import style
from paper.figures import reproduce

scenario = osc.load_scenario(
    "two_contact_rod",
    ["plant.type=rigid", "plant.step=2 ms", "control.rate=500 Hz",
     "force.left_end.1.start=0.1 s", "model_error.arm_mass=1.2", "motion.0.signals.0.ramp=0.2 s"],
)  # fmt: skip
reproduce("fig5", scenario)

# %% [markdown]
# ## A law is a function of two signals
#
# `force_law` puts a law α_u = law(α_d, α_meas) in the place of the built-in one. It is given what
# makes the law, so that laws with a memory start afresh in every run.


# %%
def proportional(gain):
    return lambda: lambda desired, measured: desired + gain * (desired - measured)


class FeedForward:
    def __call__(self, desired, measured):
        return desired


class Integral:
    """Feed-forward and an integral that leaks: it forgets an old error within a second."""

    gain, forget, dt = 60.0, 1.0, 2e-3

    def __init__(self):
        self.sum = 0.0

    def __call__(self, desired, measured):
        self.sum += self.dt * (self.gain * (desired - measured) - self.forget * self.sum)
        return desired + self.sum


# %% [markdown]
# The controller's model of the arms is 20 % too heavy, so that feed-forward alone is off. One
# force steps by 5 N at 0.1 s.

# %%
laws = {
    "feed-forward": force_law(FeedForward),
    "leaking integral": force_law(Integral),
    "proportional, gain 0.5": force_law(proportional(0.5)),
    "built in": None,
}
runs = {name: osc.run(scenario, duration=0.2, install=law) for name, law in laws.items()}
with style():
    figure, axes = plt.subplots(figsize=(7, 3.5))
    for i, (name, recording) in enumerate(runs.items()):
        error = recording["alpha_true"][:, 0] - recording["alpha_cmd"][:, 0]
        axes.plot(recording["t"], error, color=contact_colour(i), label=name)
        print(f"{name}: error at the end {error[-1]:+.2f} N")
    axes.set(xlabel="t (s)", ylabel="force error, left end (N)", ylim=(-5, 2))
    axes.legend()
plt.close(figure)
figure

# %% [markdown]
# No force law removes the remaining error: the grippers beyond the sensors are too heavy in the
# model as well, and a wrist sensor measures a weight like a contact force. A tare before contact
# removes it.
#
# ## Why the built-in law has no proportional part
#
# A rigid contact answers within the tick. The sensors show it one tick later, so a proportional
# gain k makes e ← −k e of every error e: it decays below 1 and grows above, at any rate of the
# loop.

# %%
for gain in (0.5, 0.9, 1.1):
    recording = osc.run(scenario, duration=0.08, install=force_law(proportional(gain)))
    error = recording["alpha_true"][:, 0] - recording["alpha_cmd"][:, 0]
    jumps = np.abs(np.diff(error))
    print(f"gain {gain}: swing between ticks {jumps[1]:.2f} N, after 40 {jumps[-1]:.2g} N")

# %% [markdown]
# ## And the motion?
#
# It does not depend on the force law. On this exact plant the rod makes the same motion to
# the last digits.

# %%
for name in ("leaking integral", "proportional, gain 0.5"):
    apart = runs[name]["pose"] - runs["built in"]["pose"]
    print(f"{name}: {np.abs(apart[:, :3]).max():.1e} m away from the built-in law's rod")
plots.tracking(runs["leaking integral"])

# %%
from pathlib import Path

from osc_contact.lab.reports.viewing import write_scene_of
from osc_contact.lab.visual.page import embed

embed(write_scene_of(runs["leaking integral"], osc.build_rig(scenario), Path("scene.html")))

# %% [markdown]
# Try next: a law with a deadband, a limit on the rate of change, one per contact. On MuJoCo
# (`plant.type=mujoco`) contacts are soft and can open, which forgives or punishes other things.
