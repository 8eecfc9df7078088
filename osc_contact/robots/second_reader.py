"""A second URDF reader, on the original file: both must put every link in the same place."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin

from osc_contact.robots.findings import ModelFinding, refuse
from osc_contact.robots.model import frame_id, random_configurations

__all__ = ["CROSS_CHECK_TOLERANCE", "compare"]

CROSS_CHECK_TOLERANCE = 1e-9
_SAMPLES = 5


def compare(model: pin.Model, file: Path) -> float:
    """Largest difference of a link placement between the model and yourdfpy.

    Entries of the 4×4 placements relative to the root link (rotations without unit, translations
    in m) at neutral and five seeded random configurations; mimic joints follow in both.

    Raises:
        ModelError: yourdfpy fails, or the difference exceeds 1e-9, with link and size.
    """
    import yourdfpy

    try:
        other = yourdfpy.URDF.load(str(file), load_meshes=False, build_scene_graph=True)
        worst, where = _difference(model, other)
    except (ValueError, KeyError, TypeError, AttributeError, IndexError, RecursionError) as error:
        reason = f"the second reader (yourdfpy) fails: {type(error).__name__}: {error}"
        refuse([ModelFinding("second reader", file, 0, 0, "", reason, "")])
    if not worst <= CROSS_CHECK_TOLERANCE:
        reason = (
            f"two URDF readers place link {where!r} {worst:.3g} apart (allowed "
            f"{CROSS_CHECK_TOLERANCE:g})"
        )
        refuse([ModelFinding("second reader", file, 0, 0, f"link {where!r}", reason,
                        "look at the origins and axes of the joints above it")])  # fmt: skip
    return worst


def _difference(model: pin.Model, other: "yourdfpy.URDF") -> tuple[float, str]:  # type: ignore[name-defined]  # noqa: F821, UP037
    data = model.createData()
    root = other.base_link
    index = {name: model.joints[model.getJointId(name)].idx_q for name in list(model.names)[1:]}
    worst, where = 0.0, root
    for q in (pin.neutral(model), *random_configurations(model, _SAMPLES)):
        for name, joint in other.joint_map.items():
            if joint.mimic is not None and name in index:
                master = q[index[joint.mimic.joint]]
                q[index[name]] = joint.mimic.multiplier * master + joint.mimic.offset
        if index:
            other.update_cfg({name: q[index[name]] for name in other.actuated_joint_names})
        pin.framesForwardKinematics(model, data, q)
        X_WR = data.oMf[frame_id(model, root)]
        for link in other.link_map:
            ours = X_WR.actInv(data.oMf[frame_id(model, link)]).homogeneous
            difference = float(np.abs(ours - other.get_transform(link, root)).max())
            if not difference <= worst:
                worst, where = difference, link
    return worst, where
