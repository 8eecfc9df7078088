"""What passes the controller's door: settings, measurements and references in, torques out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from osc_contact.contacts.contact import Contact
from osc_contact.contacts.pairs import ContactPair
from osc_contact.control.friction import Friction
from osc_contact.dynamics.closed_chain import ClosedChain
from osc_contact.dynamics.rail import Body
from osc_contact.errors import InvalidInputError
from osc_contact.interface import Measurement, Reference, Touched, as_squeeze
from osc_contact.spatial import Array, as_array
from readable.linkage import bars
from readable.signals import Signals

__all__ = ["independent", "limited", "require_sound", "take_in"]


def require_sound(
    chain: ClosedChain,
    contacts: Sequence[ContactPair],
    dt: float,
    B: Array | str,
    bodies: Sequence[Body | None] | None,
    friction: Friction | None,
) -> None:
    """Refuse what no controller can be made of; see `Controller`.

    Raises:
        InvalidInputError: with what is wrong.
    """
    if not (np.isfinite(dt) and dt > 0.0):
        raise InvalidInputError(f"dt = {dt}; give the control period in seconds, > 0")
    if isinstance(B, str) and B not in ("object", "chain"):
        raise InvalidInputError(f"B = '{B}'; give 'object', 'chain' or a (6, 6) matrix")
    blind = [arm.name for arm in chain.arms if arm.wrist_sensor is None]
    if contacts and blind:
        raise InvalidInputError(
            f"contact forces are measured in the wrists of all arms together, but {blind} "
            "have no wrist_sensor; name its frame when loading the arm"
        )
    if bodies is not None and len(bodies) != len(contacts):
        raise InvalidInputError(
            f"{len(contacts)} contacts but {len(bodies)} bodies; give one for each contact"
        )
    if friction is not None:
        friction.require_known_points(contacts)


def take_in(
    measurement: Measurement, reference: Reference, s: Signals, arms: int, contacts: int
) -> None:
    """Put what was measured and what is wanted on the signals, if sizes and numbers are right.

    Raises:
        InvalidInputError: wrong shapes or non-finite numbers.
    """
    s.q, s.v = measurement.q, measurement.v
    s.wrenches = as_array("wrist wrenches", measurement.wrenches, (arms, 6))
    s.touched = None if measurement.touched is None else _checked(measurement.touched, contacts)
    s.alpha_d = as_array("reference alpha_d", reference.alpha_d, (None,))
    s.squeeze_d = as_squeeze("reference squeeze_d", reference.squeeze_d, bars(arms))
    if arms < 3 and np.ndim(s.squeeze_d):
        raise InvalidInputError(f"reference squeeze_d: {arms} arms take a number, got an array")
    as_array("reference V_D", reference.V_D, (6,))
    as_array("reference A_D", reference.A_D, (6,))
    as_array("reference X_WD", reference.X_WD.homogeneous, (4, 4))
    s.reference = reference


def _checked(touched: Touched, contacts: int) -> Touched:
    return Touched(
        as_array("touched X_WE", touched.X_WE, (contacts, 4, 4)),
        as_array("touched V_E", touched.V_E, (contacts, 6)),
        as_array("touched A_E", touched.A_E, (contacts, 6)),
    )


def independent(alpha_d: Array, contact: Contact) -> Array:
    """Desired magnitudes (r,) of the independent columns of N from those of all columns."""
    if len(alpha_d) != contact.R.shape[1]:
        raise InvalidInputError(
            f"reference alpha_d: {len(alpha_d)} forces for {contact.R.shape[1]} columns of N; give "
            "one for each degree of constraint, contact after contact"
        )
    return contact.R @ alpha_d


def limited(tau: Array, chain: ClosedChain) -> tuple[Array, str]:
    """All torques scaled by one factor until every motor is within its limit, and why if they were.

    For control laws put in place of ours; `effort_limits` knows ours and keeps it decoupled.
    """
    share = np.abs(tau) / chain.tau_max
    excess = float(np.max(share, initial=0.0))
    if excess <= 1.0:
        return tau, ""
    motor = int(np.argmax(share))
    name = chain.joint_names[chain.actuated[motor]]
    return tau / excess, f"{name}: {tau[motor]:.4g} of ±{chain.tau_max[motor]:.4g} wanted"
