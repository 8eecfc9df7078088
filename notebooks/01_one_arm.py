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
# # One arm's operational space
#
# A Panda arm at its tip: apparent mass, forces of velocity and weight, and
# how a desired acceleration of the tip becomes torques. Equation numbers are those of the paper.
# Twists are [v; ω] and wrenches [f; m], both at the tip and in world axes.

# %%
# %matplotlib inline
import numpy as np
import pinocchio as pin

import osc_contact as osc
from osc_contact import robots

np.set_printoptions(precision=3, suppress=True, linewidth=100)
urdf, package_dir = robots.find_robot("panda")  # from example-robot-data, no network
panda = osc.Arm.from_urdf(urdf, name="panda", tip="panda_hand_tcp")
chain = osc.ClosedChain([panda])  # one arm that holds nothing

# %% [markdown]
# ## Φ, Λ, μ, p
#
# Φ = J M⁻¹ Jᵀ is the inverse inertia at the tip, Λ = Φ⁻¹ the inertia, μ what the velocities
# cause, p the weight (13). A push along a unit vector u meets the apparent mass 1 / uᵀΦu.

# %%
q = np.array([0.0, -0.3, 0.0, -2.0, 0.0, 1.7, 0.785])
v = 0.3 * np.ones(7)
arm = chain.state(q, v).arms[0]
print("Λ =\n", arm.Lambda)
print("μ =", arm.mu, "\np =", arm.p)
for name, u in zip("xyz", np.eye(3), strict=True):
    print(f"apparent mass along {name}: {1 / (u @ arm.Phi[:3, :3] @ u):.2f} kg")

# %% [markdown]
# The apparent mass depends on direction and posture. Here it is in the vertical plane through the
# arm, for three postures.

# %%
from matplotlib import pyplot as plt

from osc_contact.lab.visual import contact_colour
from osc_contact.lab.visual.plots import style

angle = np.linspace(0, 2 * np.pi, 181)
directions = np.array([np.cos(angle), 0 * angle, np.sin(angle)])
with style():
    figure, axes = plt.subplots(figsize=(5, 5), subplot_kw={"projection": "polar"})
    for i, elbow in enumerate((-2.6, -2.0, -0.6)):
        posture = q.copy()
        posture[3] = elbow
        Phi = chain.state(posture, 0 * v).arms[0].Phi[:3, :3]
        mass = 1 / np.einsum("ik,ij,jk->k", directions, Phi, directions)
        axes.plot(angle, mass, color=contact_colour(i), label=f"elbow at {elbow} rad")
    axes.set_title("apparent mass (kg), 0° forwards, 90° upwards")
    axes.legend(loc="upper left", bbox_to_anchor=(0.85, 0.1))
plt.close(figure)
figure

# %% [markdown]
# ## Does Λa + μ + p hold?
#
# τ = Jᵀ(Λa + μ + p) should give the tip exactly the acceleration a. Pinocchio's forward dynamics
# decides. Torques in the null space, (1 − JᵀJ̄ᵀ)τ₀, must not act at the tip.

# %%
a = np.array([0.5, 0.0, 1.0, 0.0, 2.0, 0.0])  # m/s², rad/s²
data = panda.model.createData()
inner = (np.eye(7) - arm.J.T @ arm.J_bar.T) @ np.array([5.0, -3.0, 2.0, 1.0, 4.0, 0.5, 1.0])
for name, extra in (("task torques alone", 0.0), ("with null-space torques", inner)):
    tau = arm.J.T @ (arm.Lambda @ a + arm.mu + arm.p) + extra
    qdd = pin.aba(panda.model, data, q, v, tau)
    print(f"{name}: miss {np.abs(arm.J @ qdd + arm.gamma - a).max():.1e}, q̈ =", qdd)

# %% [markdown]
# ## The tip on a circle
#
# Gains on the pose error make a tracking law of it. Six motions are controlled, the seventh, in
# the null space, is damped.

# %%
from osc_contact.spatial import classical_to_spatial, pose_error

dt, w = 1e-3, 2 * np.pi
start = chain.state(q).X_WO
x, qd, rows, miss = q.copy(), np.zeros(7), [], 0.0
for k in range(2000):
    state = chain.state(x, qd)
    arm, t = state.arms[0], k * dt
    s, c = 0.1 * np.sin(w * t), 0.1 * np.cos(w * t)  # radius 0.1 m, once per second
    aim = pin.SE3(start.rotation, start.translation + [0, s, 0.1 - c])
    V_D, A_D = w * np.array([0, c, s, 0, 0, 0]), w**2 * np.array([0, -s, c, 0, 0, 0])
    error = pose_error(aim, state.X_WO)
    a = classical_to_spatial(A_D + 40 * (V_D - state.V_O) + 400 * error, state.V_O)
    tau = arm.J.T @ (arm.Lambda @ a + arm.mu + arm.p)
    tau += (np.eye(7) - arm.J.T @ arm.J_bar.T) @ (-5.0 * qd)
    qd = qd + pin.aba(panda.model, data, x, qd, tau) * dt
    x = x + qd * dt
    rows.append(x)
    miss = max(miss, np.abs(error[:3]).max()) if t > 1.0 else miss
print(f"largest miss after 1 s: {1e3 * miss:.2f} mm")

# %%
from osc_contact.lab.visual.page import embed
from osc_contact.lab.visual.parts import Content, Visual
from osc_contact.lab.visual.scene import write_scene

fingers = np.full((len(rows), 2), 0.02)  # the drawing has two joints more than the chain
recording = osc.Recording({}, {"t": dt * np.arange(len(rows)), "q": np.hstack((rows, fingers))})
drawn = Visual("panda", urdf, [package_dir], panda.base, slice(0, 9))
embed(write_scene(recording, Content("the tip on a circle", [drawn]), "circle.html"))
