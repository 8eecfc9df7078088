"""Speeds at which the object of a rig is commanded to slide over its contacts."""

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from osc_contact.contacts.feet import feet
from osc_contact.contacts.pairs.pair import ContactPair
from osc_contact.lab.rig.references import References
from osc_contact.spatial import Array, carry_twist


def slip_speeds(pairs: Sequence[ContactPair], references: References) -> Array:
    """Largest commanded slip speed (k, contacts) of each contact's points on faces at rest (m/s).

    Args:
        pairs: contacts. references: references, whose `overview` gives the k instants.
    """
    plan = references.overview[1]
    speeds = np.zeros((len(plan.X_WD), len(pairs)))
    for row, pose, V in zip(speeds, plan.X_WD, plan.V_D, strict=True):
        X = pin.XYZQUATToSE3(pose)
        for i, pair in enumerate(pairs):
            for point, normal in zip(*feet(pair, X), strict=True):
                v = carry_twist(V, X.translation, point)[:3]
                row[i] = max(row[i], np.linalg.norm(v - normal * (normal @ v)))
    return speeds
