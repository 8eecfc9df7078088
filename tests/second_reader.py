"""Link placements of our readers against those of yourdfpy and MuJoCo."""

import mujoco
import numpy as np
import pinocchio as pin
import yourdfpy
from rigs import data_at

from osc_contact import robots


def postures(model):
    return [pin.neutral(model), *robots.random_configurations(model, 5)]


def largest_difference(model, theirs):
    """Over `postures`, of all entries of the 4×4 placements in the world.

    Args:
        model: of ours. theirs: joint positions by name → placements by name; it may move
            joints that follow others.
    """
    names = list(model.names)[1:]
    worst = []
    for q in postures(model):
        joints = dict(zip(names, q, strict=True))
        placements = theirs(joints)
        data = data_at(model, np.array(list(joints.values())))
        for name, X in placements.items():
            worst.append(np.abs(data.oMf[robots.frame_id(model, name)].homogeneous - X).max())
    return max(worst)


def urdf_difference(file, **how):
    """Difference of a model from its URDF; mimic joints follow their masters."""
    other = yourdfpy.URDF.load(str(file), load_meshes=False, build_scene_graph=True)

    def placements(joints):
        for name in joints:
            if mimic := other.joint_map[name].mimic:
                joints[name] = mimic.multiplier * joints[mimic.joint] + mimic.offset
        if joints:
            other.update_cfg({name: joints[name] for name in other.actuated_joint_names})
        return {link: other.get_transform(link, other.base_link) for link in other.link_map}

    return largest_difference(robots.load_model(file, **how), placements)


def mjcf_difference(file):
    mj = mujoco.MjModel.from_xml_path(str(file))
    data = mujoco.MjData(mj)
    model = robots.load_mjcf(mj)

    def placements(joints):
        for name, position in joints.items():
            data.joint(name).qpos = position
        mujoco.mj_kinematics(mj, data)
        return {
            body.name: pin.SE3(body.xmat.reshape(3, 3), body.xpos).homogeneous
            for body in map(data.body, range(mj.nbody))
            if model.existBodyName(body.name)
        }

    return largest_difference(model, placements)
