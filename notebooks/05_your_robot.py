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
# # Your own robot
#
# From a URDF to a controlled contact: check the file, describe the task in YAML, run, look. The
# robot is a flat arm of three joints that presses a pin against a wall and slides it along.

# %%
# %matplotlib inline
from pathlib import Path

import osc_contact as osc
from osc_contact import robots


def link(name, mass, length):
    """A bar along x with its inertia."""
    side, long = mass * 0.04**2 / 6, mass * (length**2 + 0.04**2) / 12
    return f"""
  <link name="{name}">
    <inertial>
      <origin xyz="{length / 2} 0 0"/>
      <mass value="{mass}"/>
      <inertia ixx="{side:.6g}" iyy="{long:.6g}" izz="{long:.6g}" ixy="0" ixz="0" iyz="0"/>
    </inertial>
    <visual>
      <origin xyz="{length / 2} 0 0"/>
      <geometry><box size="{length} 0.04 0.04"/></geometry>
    </visual>
  </link>"""


def joint(name, parent, child, x, effort):
    return f"""
  <joint name="{name}" type="revolute">
    <parent link="{parent}"/> <child link="{child}"/>
    <origin xyz="{x} 0 0"/>
    <axis xyz="0 0 1"/>
    <limit lower="-2.8" upper="2.8" effort="{effort}" velocity="6"/>
  </joint>"""


arm = f"""<?xml version="1.0"?>
<robot name="flat_arm">
  <link name="base"/>{link("upper", 2.0, 0.4)}{link("fore", 1.5, 0.35)}{link("hand", 0.5, 0.1)}
  {joint("shoulder", "base", "upper", 0.0, 40)}{joint("elbow", "upper", "fore", 0.4, 25)}
  {joint("wrist", "fore", "hand", 0.35, 8)}
  <link name="tip"/>
  <joint name="tip_joint" type="fixed">
    <parent link="hand"/> <child link="tip"/> <origin xyz="0.1 0 0"/>
  </joint>
</robot>
"""
pin = f'<?xml version="1.0"?>\n<robot name="pin">{link("pin", 0.2, 0.06)}\n</robot>\n'
for robot, text in (("flat_arm", arm), ("pin", pin)):
    Path(f"{robot}.urdf").write_text(text)

# %% [markdown]
# ## Is it sound?
#
# A file is checked before Pinocchio reads it. A mistake is refused with line, reason and cure.

# %%
model = robots.load_model("flat_arm.urdf")
print(list(model.names)[1:], "mass", round(sum(i.mass for i in model.inertias), 3), "kg")
_ = Path("slip.urdf").write_text(arm.replace('<mass value="1.5"/>', '<mass value="1,5"/>'))
try:
    robots.load_model("slip.urdf")
except osc.ModelError as error:
    print(error)

# %% [markdown]
# `osc-contact check flat_arm.urdf` prints the same, and what the tip can do.
#
# ## The task
#
# Three joints give the tip three motions: two in the plane and one turn. The arm's structure
# carries the rest, with nothing to configure. The wrist sensor is the joint `wrist` itself. The
# wall is packaged.

# %%
_ = Path("wall.yaml").write_text("""
name: pin_on_wall
description: a flat arm presses a pin on a wall and slides it along
arms:
  - name: flat
    urdf: flat_arm.urdf
    tip: tip
    wrist_sensor: hand
    posture: [0.9, -1.5, 0.6]
object:
  urdf: pin.urdf
  pose: {xyz: [0.68, 0.12, 0]}
grasps:
  flat: {xyz: [0, 0, 0]}
contacts:
  - name: pin
    type: vertex_on_face
    vertex: [60 mm, 0, 0]
    face: {urdf: face.urdf, point: [0.75, 0, 0], normal: [-1, 0, 0]}
force:
  pin:
    - {type: constant, value: 10 N}
    - {type: step, value: 5 N, start: 0.6 s}
motion:
  - kind: linear
    direction: [0, 1, 0]
    signals: [{type: sine, amplitude: 60 mm, frequency: 1 Hz, ramp: 0.3 s}]
gains:
  motion: {stiffness: 900, damping: 60}
  force: {integral: 30, damping: 50}
control: {rate: 500 Hz}
plant: {type: rigid, step: 1 ms}
duration: 2 s
""")
scenario = osc.load_scenario("wall.yaml")
rig = osc.build_rig(scenario)
state = rig.state
print("motions of the object:", state.d, " carried by the structure:", state.C.shape[1])
print("Λ_S =\n", state.Lambda_S.round(3))

# %% [markdown]
# ## Run and judge

# %%
from osc_contact.lab.visual import plots

recording = osc.run(scenario, duration=1.5)
verdict = osc.metrics(recording)
force, motion = verdict["force"]["pin"], verdict["motion"]
print(f"force: {force['mean_command_N']:.1f} N, rms error {force['rms_error_N']:.4f} N")
print(f"motion: rms error {1e3 * motion['rms_error_m']:.3f} mm; ticks {verdict['status']}")
plots.contact_forces(recording)

# %%
plots.torques(recording)

# %%
from osc_contact.lab.reports.viewing import write_scene_of
from osc_contact.lab.visual.page import embed

embed(write_scene_of(recording, rig, Path("scene.html")))

# %% [markdown]
# ## What comes next
#
# | question | answer |
# |---|---|
# | several arms, passive joints | one entry more in `arms` and `grasps`, `passive_joints` |
# | a robot that is not exactly known | `model_error.arm_mass`, `tare` |
# | contacts that open, friction | `plant: {type: mujoco, …}` |
# | other contacts and laws; own loop, hardware | docs/extend.md; docs/own_loop.md |
