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
# # Two contacts, one rod, no constraint frame
#
# Two SCARA arms hold a rod by hinged grippers. Each end of the rod presses on a tilted face, and
# the rod slides along the one direction that lies in both faces. Two contact forces and
# the free motion are controlled at the same time, independent of one another.
#
# Equation numbers are those of the paper. Twists are [v; ω] and wrenches [f; m], both at the
# rod's origin O and in world axes.

# %%
# %matplotlib inline
import numpy as np

import osc_contact as osc
from osc_contact.lab.checks.inspection import inspect_rig

np.set_printoptions(precision=4, suppress=True, linewidth=100)
scenario = osc.load_scenario("two_contact_rod", ["plant.type=rigid", "plant.step=1 ms"])
rig = osc.build_rig(scenario)  # loads the URDFs, closes the loop, puts the rod onto the faces

# %% [markdown]
# ## The state of contact
#
# N spans the wrenches that the contacts transmit, T the twists they permit, and NᵀT = 0: a
# contact force has no power in a permitted motion. Each contact contributes one column to N,
# its force pushing *into* the face.

# %%
contact = rig.contact
print("N =\n", contact.N, "\nT =\n", contact.T)
print("largest |NᵀT| =", np.abs(contact.N.T @ contact.T).max())

# %% [markdown]
# ### Why a selection matrix cannot hold it
#
# A frame with selected axes gives three lines of force through one point, at right angles. Our
# two lines do not even meet, and the angle between them is not a right one.

# %%
found = inspect_rig(rig)
print("\n".join(line for line in found.lines if "lines of force" in line))

# %%
from paper.figures import reproduce

reproduce("fig1", scenario)

# %% [markdown]
# ## The closed chain
#
# Vertical joint axes and hinges leave the rod d = 5 motions S; the couple about its own axis
# is carried by the structure. In these motions the inertia of arms and rod is Λ_S (5×5),
# and Φ₀ = S Λ_S⁻¹ Sᵀ takes the place of Λ₀⁻¹: 6×6, of rank 5. Nothing
# is damped or inverted by force.

# %%
state = rig.state
print("d =", state.d, "  Λ_S", state.Lambda_S.shape, "  rank Φ₀ =",
      np.linalg.matrix_rank(state.Phi, tol=1e-9 * np.linalg.norm(state.Phi)))  # fmt: skip
print("carried by the structure:", state.C.ravel())
print(f"free motions: d − r = {state.d} − {contact.r} = {state.d - contact.r}")
print("\n".join(line for line in found.lines if line.startswith("free motion")))

# %% [markdown]
# ## Projections
#
# Ω_f (eq. 5) keeps the part of a wrench that lies in N, Ω_m (eq. 7) the part of a
# twist that lies in T. They need Φ₀ only, so the rank does not matter. Different metrics
# split a wrench differently, but each gives a projection, and projected forces never have power.

# %%
Lambda_o = state.payload.Lambda  # the rod alone, 6×6
for name, A_inv in (("arms and rod", state.Phi), ("rod alone", np.linalg.inv(Lambda_o))):
    Omega_f = contact.force_projection(A_inv)
    print(f"{name:>13}: |Ω_f² − Ω_f| = {np.abs(Omega_f @ Omega_f - Omega_f).max():.1e},",
          f"|Tᵀ Ω_f| = {np.abs(contact.T.T @ Omega_f).max():.1e}")  # fmt: skip

# %% [markdown]
# ## Decoupling
#
# The controller maps commanded forces and a commanded motion to torques (eqs. 21 to 25). The
# rigid plant solves the joint-space dynamics of all arms with one multiplier for each constraint
# and shares no formula with it. A step in one desired force must leave the acceleration of the
# rod and the other contact force alone.

# %%
plant, controller = rig.plant(), rig.controller()
measurement = plant.measure()
reference = rig.references.at(0.0)
stepped = osc.Reference(
    reference.X_WD, reference.V_D, reference.A_D, reference.alpha_d + [5.0, 0.0],
    reference.squeeze_d,
)  # fmt: skip
before = plant.accelerations(controller.tick(measurement, reference))
after = plant.accelerations(rig.controller().tick(measurement, stepped))
print("step of the desired forces:", stepped.alpha_d - reference.alpha_d, "N")
print("contact forces change by:  ", after[2] - before[2], "N")
print(f"acceleration of the rod changes by {np.abs(after[1] - before[1]).max():.1e} m/s², rad/s²")

# %% [markdown]
# The force follows the step at once, plus what the integral of the force law adds in its first
# period, 30 /s · 1 ms · 5 N = 0.15 N, because the sensors do not yet measure the step.

# %% [markdown]
# The other way round: a commanded acceleration along the free motions leaves both forces alone.

# %%
free = found.free @ [0.5, 0.4, 0.3]
moving = osc.Reference(
    reference.X_WD, reference.V_D, reference.A_D + free, reference.alpha_d, reference.squeeze_d
)
after = plant.accelerations(rig.controller().tick(measurement, moving))
print("commanded acceleration:", free)
print("acceleration obtained: ", after[1] - before[1])
print(f"contact forces change by {np.abs(after[2] - before[2]).max():.1e} N")

# %% [markdown]
# ## A run
#
# Half a second on the rigid plant; then, if MuJoCo is installed, 1.2 s with compliant contacts
# that can open. Forces are judged by the plant's truth, not by the sensors.

# %%
recording = osc.run(scenario, duration=0.5)
error = recording["alpha_true"][50:] - recording["alpha_cmd"][50:]
print("rigid plant: largest force error after 50 ms:", np.abs(error).max(axis=0), "N")

# %%
from importlib.util import find_spec

if find_spec("mujoco"):
    soft = osc.load_scenario("two_contact_rod", ["force.left_end.1.start=0.6 s"])
    recording = osc.run(soft, duration=1.2)
    for name, force in osc.metrics(recording)["force"].items():
        print(f"MuJoCo, {name}: rms error {100 * force['rms_error_rel']:.3f} % of the command")

# %% [markdown]
# The forces over time, as in fig. 8. The rigid plant keeps the two ends apart to rounding.
# MuJoCo's faces yield a little, which the controller does not model: the step on the left end
# leaves a short trace on the right one. The sliding motion leaves next to none on either.

# %%
from osc_contact.lab.visual import plots

plots.contact_forces(recording)

# %%
from pathlib import Path

from osc_contact.lab.reports.viewing import write_scene_of
from osc_contact.lab.visual.page import embed

embed(write_scene_of(recording, rig, Path("scene.html")))

# %% [markdown]
# ## What to change
#
# A scenario is one YAML file; `osc-contact run my_scenario.yaml` runs it. Good first changes:
#
# | key | try |
# |---|---|
# | `contacts.left_end.face.normal` | another tilt: N, T and the free motions follow |
# | `force.right_end` | other signals, such as `minimum_jerk`, `jerk_limited` or `points` |
# | `motion` | `kind: angular` with a unit vector: turn the rod instead of sliding it |
# | `model_error.object_mass` | 1.2: a heavier rod in the controller's model |
# | `plant.friction` | friction that the model lacks |
#
# Every key can also be changed from the command line: `--set squeeze="20 N"`.
