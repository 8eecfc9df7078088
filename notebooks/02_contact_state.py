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
# # A contact state, N and T, and why a selection matrix fails
#
# A state of contact is two spaces: N, the wrenches it transmits, and T, the motions it permits,
# NᵀT = 0. Hybrid control with a selection matrix requires more: one frame, along and about whose
# axes either force or motion is controlled. Many contacts have no such frame.

# %%
# %matplotlib inline
import numpy as np

import osc_contact as osc
from paper.figures import reproduce

np.set_printoptions(precision=4, suppress=True, linewidth=100)
scenario = osc.load_scenario("two_contact_rod", ["plant.type=rigid", "plant.step=1 ms"])
rig = osc.build_rig(scenario)
contact, state = rig.contact, rig.state
print("N =\n", contact.N, "\nT =\n", contact.T)
print("largest |NᵀT| =", np.abs(contact.N.T @ contact.T).max())
reproduce("fig1", scenario)

# %% [markdown]
# ## Is there a frame?
#
# Two conditions decide: the couples and the forces must share a triad of axes, and the forces
# must act through one point. The rod's two lines of force do not meet. A peg in a hole has a
# frame.

# %%
import pinocchio as pin

peg = osc.CylinderInHole(np.zeros(3), [0, 0, 1], np.zeros(3), [0, 0, 1])
hole = peg.contact(pin.SE3.Identity(), np.zeros(6)).as_raibert_craig(size=0.1)
print("peg: forces along", hole.forces, "couples about", hole.couples)
rod = contact.as_raibert_craig(size=0.58)
print("rod:", rod.reason)
print(f"the nearest frame misses N by {np.degrees(np.arcsin(rod.residual)):.1f}°")

# %% [markdown]
# ## What the nearest frame costs
#
# The best a selection matrix can do, searched over all frames: the law with that frame, against
# ours that takes N itself. A force command should not accelerate the rod along its free motions,
# and a motion command should not change a force. By how much do they?

# %%
from paper.baselines import measured_coupling
from paper.selection_laws import BASELINES, Instant, Ours, best_selection

instant = Instant(state, contact)
laws = {"ours": Ours(), "selection": best_selection(instant, BASELINES["khatib"], restarts=0)}
for name, law in laws.items():
    coupling = measured_coupling(rig, law, instant)
    print(f"{name}: free acceleration per newton up to {np.abs(coupling.G_f).max():.1e},",
          f"newtons per free acceleration up to {np.abs(coupling.G_m).max():.1e}")  # fmt: skip

# %% [markdown]
# ## In motion
#
# The same controller, plant and gains; only the two boxes differ that contain the selection. The
# rod slides, and one force steps at 0.25 s.

# %%
from osc_contact.lab.visual import plots

moving = osc.load_scenario(
    "two_contact_rod",
    ["plant.type=rigid", "plant.step=2 ms", "control.rate=500 Hz",
     "force.left_end.1.start=0.25 s", "gains.force.rise=0 s", "motion.0.signals.0.ramp=0.2 s"],
)  # fmt: skip
runs = {name: osc.run(moving, duration=0.4, install=law.install) for name, law in laws.items()}
for name, recording in runs.items():
    error = np.abs(recording["alpha_true"] - recording["alpha_cmd"])
    print(f"{name}: force error before the step at most {error[50:125].max():.3f} N")

# %% [markdown]
# The two forces under the selection law: each follows the motion and the other force.

# %%
judged = np.ones((len(runs["ours"]), 2), dtype=bool)
judged[:50] = judged[125:150] = False  # the start, and the step: shaded
plots.contact_forces(runs["selection"], judged)

# %% [markdown]
# Under ours they do not.

# %%
plots.contact_forces(runs["ours"], judged)

# %%
from pathlib import Path

from osc_contact.lab.reports.viewing import write_scene_of
from osc_contact.lab.visual.page import embed

embed(write_scene_of(runs["ours"], osc.build_rig(moving), Path("scene.html")))

# %% [markdown]
# `osc-contact reproduce baselines` makes the whole comparison: two laws from the literature, each
# with the best frame there is for it, on both plants.
