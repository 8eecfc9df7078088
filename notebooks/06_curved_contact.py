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
# # Contact on a curved face
#
# A ball that slides on a plane keeps its normal. On a curved face the normal turns with the place,
# ṅ = ω_E × n + ∇²φ v_rel, φ the signed distance. N contains n; the curvature ∇²φ appears in n_γ
# alone, the normal acceleration that keeps the contact (section 3 of the paper).

# %%
# %matplotlib inline
import numpy as np
import pinocchio as pin
from matplotlib import pyplot as plt

import osc_contact as osc
from osc_contact.lab.visual import contact_colour
from osc_contact.lab.visual.plots import style

radius, ball = 0.1, 0.012
pair = osc.SphereOnSurface([0, 0, 0], ball, osc.Surface.sphere(radius))
X = pin.SE3(np.eye(3), np.array([0, 0, radius + ball]))
for speed in (0.05, 0.2, 0.5):
    n_gamma = pair.contact(X, np.array([speed, 0, 0, 0, 0, 0])).n_gamma[0]
    print(f"{speed} m/s: n_γ = {n_gamma:.4f} m/s², v²/(R + ρ) = {speed**2 / (radius + ball):.4f}")

# %% [markdown]
# ## Any smooth face
#
# A surface is a sphere, a cylinder, a saddle, or a spline fitted to points of a scan. Its normal
# and curvature at the foot of the ball are exact. Here the n_γ of a fit is compared with the second
# derivative of the gap along a motion of constant twist, taken by differences.

# %%
rng = np.random.default_rng(0)
x, y = rng.uniform(-0.06, 0.06, (2, 4000))
scan = np.array([x, y, x * y / 0.2]).T
pair = osc.SphereOnSurface([0, 0, 0], ball, osc.Surface.fitted(scan, cells=(4, 4)))
X = pin.SE3(np.eye(3), np.array([0.01, -0.02, 0.011]))
V = np.array([0.2, 0.1, 0.05, 0, 0, 0])


def gap(t):
    return pair.gaps(pin.SE3(np.eye(3), X.translation + t * V[:3]))[0]


bend = (gap(1e-3) - 2 * gap(0.0) + gap(-1e-3)) / 1e-6
print(f"n_γ = {pair.contact(X, V).n_gamma[0]:.5f}, by differences {bend:.5f} m/s²")

# %% [markdown]
# ## What curvature is worth
#
# A Panda slides to and fro over a dome at up to 0.2 m/s, its tool turned with the normal, and
# presses with 10 N, without the integral that would hide an error. One controller has the pair as
# it is. The other has a function in its place, compiled by numba, with the same N and the n_γ of a
# plane.


# %%
def tangent_plane(X_WO, V_O, X_WE, V_E, parameters, N, n_gamma, gaps, points):
    """A ball (centre, radius) on a sphere (centre, radius) that is at rest, without curvature."""
    p = X_WO[:3, :3].copy() @ parameters[:3]
    away = parameters[4:7] - X_WO[:3, 3] - p
    n = away / np.sqrt((away * away).sum())
    N[:3, 0] = n
    N[3:, 0] = np.cross(p, n)
    n_gamma[0] = -(n * np.cross(V_O[3:], V_O[:3] + np.cross(V_O[3:], p))).sum()
    points[:, 0] = X_WO[:3, 3] + p + parameters[3] * n


scenario = osc.load_scenario("panda_dome", ["plant.friction=0", "gains.force.integral=0"])


def slide(flat):
    rig = osc.build_rig(scenario)
    (pair,) = rig.pairs
    controller = rig.controller()
    if flat:
        given = [*pair.centre, pair.radius, *pair.surface_point, 0.3]
        one = osc.CompiledPair(tangent_plane, given, pushes=True, name=pair.name)
        controller = osc.Controller(rig.chain, [one], gains=controller.gains, dt=controller.dt)
    references = osc.surface_references(
        pair, rig.state.X_WO, controller.dt, direction=[1, 0, 0], force=10.0, duration=2.0,
        points=[[0.06, 0.0], [-0.06, 0.0], [0.06, 0.0]], feed=0.2, acceleration=2.0, jerk=40.0,
    )  # fmt: skip
    recorder = osc.Recorder(controller)
    osc.run_loop(rig.plant(), controller, references, recorder=recorder)
    return recorder.recording()


runs = {"with curvature": slide(False), "tangent plane": slide(True)}
with style():
    figure, axes = plt.subplots(figsize=(7, 3.5))
    for i, (name, recording) in enumerate(runs.items()):
        error = recording["alpha_meas"][500:, 0] - 10.0
        axes.plot(recording["t"][500:], error, color=contact_colour(i), label=name)
        print(f"{name}: force error at most {np.abs(error).max():.3f} N")
    axes.set(xlabel="t (s)", ylabel="force error (N)")
    axes.legend()
plt.close(figure)
figure

# %% [markdown]
# ## Friction that the controller does not know
#
# The packaged scenario: a raster, 10 N ± 3 N, friction 0.1. Normal and friction are estimated while
# the ball slides.

# %%
from pathlib import Path

from osc_contact.lab.reports.viewing import write_scene_of
from osc_contact.lab.visual import plots
from osc_contact.lab.visual.page import embed

wiping = osc.load_scenario("panda_dome")
recording = osc.run(wiping, duration=3.0)
force = osc.metrics(recording)["force"]["ball"]
print(f"force error {100 * force['rms_error_rel']:.2f} % rms")
plots.contact_forces(recording, np.ones((len(recording), 1), dtype=bool))

# %%
embed(write_scene_of(recording, osc.build_rig(wiping), Path("scene.html")))

# %% [markdown]
# More: docs/polish_curved_part.md has faces of three shapes, misplaced ones, and two arms.
