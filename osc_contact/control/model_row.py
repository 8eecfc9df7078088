"""A controller's chain, contacts and settings as the records of `law.tables`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from osc_contact.control.joint_limits import JointLimitAvoidance
from osc_contact.control.pair_rows import PairRows
from osc_contact.dynamics.arm import effort_scale
from osc_contact.dynamics.chain_rows import pack_chain
from osc_contact.dynamics.rail import Body, Cart, Conveyor
from osc_contact.law import tables as at
from osc_contact.law.layout import Bytes, new_model
from osc_contact.law.safety import BRAKE_RATE
from osc_contact.law.watch import SURE
from osc_contact.scenarios.control_schema import Friction
from osc_contact.scenarios.spec import Spec

if TYPE_CHECKING:
    from osc_contact.control.settings import Settings

__all__ = ["SLIDING_SLIP", "TURNING_SLIP", "ModelRow"]

_NEVER = 1e12  #: ticks
#: Speed of a joint from which on its dry friction counts as fully developed (rad/s, m/s).
TURNING_SLIP, SLIDING_SLIP = 1e-3, 3e-4


class ModelRow:
    """The bytes of one controller's MODEL row, and how large its MEMORY and WORK are.

    Attributes:
        raw: the bytes. head: its MODEL record. pairs: the contact pairs as rows.
    """

    def __init__(self, settings: Settings, columns: dict[int, int]) -> None:
        """Pack them; `columns`: numbers of columns of pairs that only Python can evaluate."""
        chain, pairs = settings.chain, PairRows(settings.contacts, columns)
        self.pairs = pairs
        self.raw: Bytes = new_model(
            len(chain.arms), chain.nq, chain.n_a, len(settings.contacts), len(pairs.shapes),
            pairs.r_all,
        )  # fmt: skip
        self.head = at.MODEL.view(self.raw)
        pack_chain(chain, self.raw, chain.leader)
        self._pack_joints(settings)
        self._pack_contacts(settings)
        self.set_gains(settings)
        self.set_safety(settings)

    def within(self, raw: Bytes) -> ModelRow:
        """The same row at these bytes, where it has been copied to."""
        other = ModelRow.__new__(ModelRow)
        other.pairs, other.raw = self.pairs, raw
        other.head = at.MODEL.view(raw)
        return other

    def set_gains(self, settings: Settings) -> None:
        """What may differ between controllers of one structure."""
        head, dt = self.head, settings.dt
        motion, force = settings.gains.motion, settings.gains.force
        _copy(motion, head)
        head.period = dt
        _copy(
            force,
            head,
            integral="force_gain",
            damping="force_damping",
            brake="force_brake",
            rise="step_time",
        )
        drifts = force.brake > 0.0 or force.tilt > 0.0
        head.drift_share = -np.expm1(-force.drift * dt) if drifts else 0.0
        head.tilt = 2.0 * np.sin(0.5 * force.tilt)  # of a chord
        _copy(settings.posture_task, head, stiffness="posture_stiffness", damping="posture_damping")
        _copy(settings.friction or Friction(mu=0.0), head)
        head.reading = at.LEAST_SQUARES if settings.reading == "least_squares" else at.FILTER
        B = settings.B
        kinds = {"object": at.BY_OBJECT, "chain": at.BY_CHAIN}
        head.metric = kinds[B] if isinstance(B, str) else at.BY_MATRIX
        head.B_inv[:] = np.eye(6) if isinstance(B, str) else np.linalg.inv(B)
        head.phased = settings.phases is not None
        if settings.phases is not None:
            _copy(
                settings.phases,
                head,
                speed="approach_speed",
                damping="approach_damping",
                least="least_force",
                share="lost_share",
                torque_rate="phase_rate",
            )

    def set_safety(self, settings: Settings) -> None:
        """Limits of the robot, and what becomes of ticks that cannot be computed."""
        head, safety = self.head, settings.safety
        _copy(safety, head, stop_after="fault_ticks")
        # s from the decision to stop until the brakes are on, as far as stopping ways are concerned
        head.reaction = 0.5 / safety.hold_rate + 0.5 / BRAKE_RATE + SURE
        head.guarded = 1
        head.fast_ticks = round(min(safety.overspeed_time / settings.dt, _NEVER))
        weight = 9.81 * settings.chain.reference.inertia.mass
        head.force_range = max(safety.force_range, 3.0 * weight)
        head.torque_range = max(safety.torque_range, 3.0 * weight)  # on a lever of 1 m
        model = settings.chain.model
        rows = self.head.joints
        watched = (rows.motor >= 0) & (safety.brake_time > 0.0)
        rows.lower[:] = np.where(watched, model.lowerPositionLimit, -np.inf)
        rows.upper[:] = np.where(watched, model.upperPositionLimit, np.inf)
        rows.brake[:] = 0.5 * safety.brake_time / rows.speed_max

    def _pack_joints(self, settings: Settings) -> None:
        chain, posture = settings.chain, settings.posture_task
        rows = self.head.joints
        limits = JointLimitAvoidance.of(chain.model, posture.limit_stiffness, posture.limit_margin)
        effort = effort_scale(chain.tau_max)
        rows.motor[:] = -1
        rows.motor[chain.actuated] = np.arange(chain.n_a)
        rows.effort[chain.actuated], rows.tau_max[chain.actuated] = effort**2, chain.tau_max
        rows.ease[chain.actuated] = 1.0 / effort**2
        speed = chain.model.velocityLimit
        rows.rated[:] = np.where(np.isfinite(speed) & (speed > 0.0), speed, np.inf)
        rows.speed_max[:] = np.where(rows.motor < 0, np.inf, rows.rated)
        rows.posture[:] = settings.posture
        for name in ("low", "high", "width", "most"):
            rows[name][:] = getattr(limits, name)
        model = chain.model
        rows.viscous[:], rows.dry[:] = model.damping, model.upperDryFrictionLimit
        rows.slip[:] = np.where(rows.slides != 0, SLIDING_SLIP, TURNING_SLIP)
        self.head.rubs = settings.joint_friction and bool(rows.viscous.any() or rows.dry.any())

    def _pack_contacts(self, settings: Settings) -> None:
        from osc_contact.contacts.pairs.pair import pushes_only

        pairs = self.pairs
        rows = self.head.pairs
        for row, values in zip(rows, pairs.table, strict=True):
            row.kind, row.first, row.count, row.shape_at, row.freedoms, row.has_friction = values
        shapes = self.head.shapes
        for shape, numbers in zip(shapes, pairs.shapes, strict=True):
            shape.row[:] = numbers
        self.head.columns.contact[:] = pairs.owners
        bodies = self.head.bodies
        for row, pair, kind in zip(
            bodies, settings.contacts, _body_kinds(settings.bodies), strict=True
        ):
            row.pushes = pushes_only(pair)
            row.kind, row.same, row.parameters[: len(kind[2])] = kind


def _copy(settings: Spec, head: Any, **names: str) -> None:
    """Copy settings into the fields of their names, or of `names` where these differ."""
    for key in type(settings).model_fields:
        if (name := names.get(key, key)) in at.MODEL.dtype.names:
            setattr(head, name, getattr(settings, key))


def _body_kinds(bodies: Sequence[Body | None]) -> list[tuple[int, int, list[float]]]:
    """Kind, first contact on the same body, parameters."""
    out: list[tuple[int, int, list[float]]] = []
    numbers: dict[Any, int] = {}
    for c, body in enumerate(bodies):
        if body is None:
            out.append((at.UNYIELDING, c, []))
            continue
        same = numbers.setdefault(body, c)
        if type(body) is Conveyor:
            out.append((at.CONVEYOR, same, []))
        elif type(body) is Cart:
            u = body.direction
            weight = float(u @ np.array(body.gravity))
            numbers_of = [*u, body.mass, body.stiffness, body.damping, body.preload, weight]
            out.append((at.CART, same, [float(x) for x in numbers_of]))
        else:
            out.append((at.ELSEWHERE, same, []))
    return out
