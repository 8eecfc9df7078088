"""Link placements by the readers of the package, compared with those of yourdfpy and MuJoCo."""

import mujoco
import numpy as np
import pinocchio as pin
import yourdfpy
from rigs import data_at

from osc_contact import robots


def postures(model):
    """Neutral configuration and five random ones, (nq,) each."""
    return [pin.neutral(model), *robots.random_configurations(model, 5)]


def largest_difference(model, theirs):
    """Largest difference of elements of the links' 4×4 placements in the world, over `postures`.

    Args:
        model: model of the package.
        theirs: function from joint positions by name to placements by name; it may change the
            positions of joints that follow others.
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
    """Largest difference between the package's model of a URDF and yourdfpy's.

    Args:
        file: the URDF.
        **how: further arguments of `robots.load_model`.
    """
    other = yourdfpy.URDF.load(str(file), load_meshes=False, build_scene_graph=True)

    def placements(joints):
        """Placements of the links by yourdfpy; mimic joints follow their masters."""
        for name in joints:
            if mimic := other.joint_map[name].mimic:
                joints[name] = mimic.multiplier * joints[mimic.joint] + mimic.offset
        if joints:
            other.update_cfg({name: joints[name] for name in other.actuated_joint_names})
        return {link: other.get_transform(link, other.base_link) for link in other.link_map}

    return largest_difference(robots.load_model(file, **how), placements)


def mjcf_difference(file):
    """Largest difference between the package's model of an MJCF file and MuJoCo's."""
    mj = mujoco.MjModel.from_xml_path(str(file))
    data = mujoco.MjData(mj)
    model = robots.load_mjcf(mj)

    def placements(joints):
        """Placements of the bodies by MuJoCo."""
        for name, position in joints.items():
            data.joint(name).qpos = position
        mujoco.mj_kinematics(mj, data)
        return {
            body.name: pin.SE3(body.xmat.reshape(3, 3), body.xpos).homogeneous
            for body in map(data.body, range(mj.nbody))
            if model.existBodyName(body.name)
        }

    return largest_difference(model, placements)
