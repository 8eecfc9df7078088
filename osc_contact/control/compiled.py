"""The compiled tick: a controller's arrays, and `kernels.tick` called on them."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin

from osc_contact.contacts.contact import Contact
from osc_contact.contacts.pairs import ContactPair, VertexOnFace
from osc_contact.control.compiling import announced
from osc_contact.control.effort_limits import GivenUp, relieve
from osc_contact.control.found import Found
from osc_contact.control.friction import Friction
from osc_contact.control.linkage import bar_forces, bars
from osc_contact.control.pack import pack
from osc_contact.control.saturated import saturated
from osc_contact.control.wires import Signals
from osc_contact.dynamics.assembly import object_pose
from osc_contact.dynamics.closed_chain import ClosedChain
from osc_contact.errors import OscContactError
from osc_contact.interface import Measurement, Reference, Touched
from osc_contact.kernels import layout as at
from osc_contact.spatial import Array

if TYPE_CHECKING:
    from osc_contact.control.controller import Controller

__all__ = ["Before", "CompiledTick", "compilable"]


@dataclass(frozen=True)
class Before:
    """What a tick began with: ∫e dt (6,), ∫(α_d − α) dt (r,), f_tare, f_bias (6,), and the terms
    of the contacts (contacts, 4)."""

    error_sum: Array
    force_sum: Array
    tare: Array
    bias: Array
    terms: Array


#: What the border refuses: wrong sizes or types of what comes in. The readable path says why.
_REFUSED = (TypeError, ValueError, AttributeError, OscContactError, np.linalg.LinAlgError)


def compilable(chain: ClosedChain, pairs: Sequence[ContactPair], friction: Friction | None) -> bool:
    """Whether the kernels know the grasps: rigid, hinge and ball, these with rigid grippers.

    A gripper with joints beyond the wrist sensor can move without the object in ways that its
    reading does not tell apart. Friction they know of vertices on faces, not of pairs derived from
    them.
    """
    if friction is not None and any(type(pair) is not VertexOnFace for pair in pairs):
        return False
    for grasp, links, tip in zip(chain.grasps, chain.outboard, chain.tips, strict=True):
        last = chain.model.frames[tip].parentJoint
        if grasp.kind == "other" or (
            not grasp.is_rigid and any(link.joint != last for link in links)
        ):
            return False
    return True


class CompiledTick:
    """One Pinocchio call and one kernel call.

    Attributes:
        state: (25,) ∫e dt, f_tare, f_bias, ∫(α_d − α) dt and how many of these count.
        tau: (n_a,) torques of the last tick that was computed.
        tare, bias: (6,) views of the state: f_tare, f_bias.
        terms: (contacts, 4) see `control.force.ContactTerms`.
        found: what the last tick found; its arrays are overwritten by the next one.
        acceleration: (n,) q̈ as commanded by the last tick that was computed, likewise.
    """

    def __init__(self, controller: Controller) -> None:
        """Pack the model and compile (or load) the kernel."""
        self._controller = controller
        chain = controller.chain
        self._model, self._data = chain.model, chain.model.createData()
        self._world = pin.Convention.WORLD
        self._arrays, self._pairs = pack(controller, self._data)
        self.state, self.tau = self._arrays[at.STATE], self._arrays[at.TAU]
        self._bound = np.zeros((at.COUNT, 4), dtype=np.int64)
        self._bind()
        self.tare, self.bias = self.state[at.TARE : at.BIAS], self.state[at.BIAS : at.FORCE_SUM]
        self.terms = self._arrays[at.TERMS][:-1]
        controller.motion_law.memory = self.state[at.ERROR_SUM : at.TARE]
        controller.force_law.memory = self.state[at.FORCE_SUM :]
        self._moved = False
        self._bodies = [
            (c, body)
            for c, body in enumerate(controller.bodies)
            if body is not None and self._arrays[at.BODIES_I][c].tolist() == [at.ELSEWHERE, c]
        ]
        self._elsewhere = bool(self._pairs.elsewhere or self._bodies)
        self._led = self._located = controller.chain.leader is not None
        arms = len(chain.arms)
        self._linked = arms if arms > 2 else 0  # internal forces are the readable path's
        self._crba, self._kernel = pin.crba, _kernel()
        self._load()

    def __call__(self, measurement: Measurement, reference: Reference) -> int:
        """OK, SATURATED or ASK: then nothing has changed, and the readable path must decide."""
        try:
            q = measurement.q
            touched = measurement.touched
            if self._linked and bar_forces(self._linked, reference.squeeze_d) is not None:
                return at.ASK
            self._crba(self._model, self._data, q, self._world)
            if touched is not None or self._moved:
                self._move(touched)
            if self._elsewhere and self.terms[:, 0].any() and not self._evaluate(measurement):
                return at.ASK
            if not self._located:
                self._locate(q)
            code: int = self._kernel(
                self._bound, q, measurement.v, measurement.wrenches, reference.X_WD.homogeneous,
                reference.V_D, reference.A_D, reference.alpha_d, reference.squeeze_d,
                self._moved,
            )  # fmt: skip
        except _REFUSED:
            return at.ASK
        self._located = self._led or code & 3 != at.ASK
        return code & 3

    def _locate(self, q: Array) -> None:
        """Tell the kernel where the object is; from then on it finds that itself, tick by tick."""
        X_WO = object_pose(self._controller.chain, q)
        self._arrays[at.SIGNALS][at.X_WO : at.X_WO + 16] = X_WO.homogeneous.ravel()

    def bare_call(self, measurement: Measurement, reference: Reference) -> Callable[[], int]:
        """The kernel on prepared arguments, at the positions last given to Pinocchio."""
        self(measurement, reference)
        return partial(
            self._kernel, self._bound, measurement.q, measurement.v, measurement.wrenches,
            reference.X_WD.homogeneous, reference.V_D, reference.A_D, reference.alpha_d,
            reference.squeeze_d, self._moved,
        )  # fmt: skip

    # --- what a tick found ---------------------------------------------------------------------

    def relieve(self) -> GivenUp:
        """Torques within the limits after SATURATED; the integrals move on without what they lack.

        Raises:
            SolverError: there are none; then nothing has changed.
        """
        controller, arrays = self._controller, self._arrays
        wanted, R, S = saturated(arrays, controller.limits)
        relief = relieve(wanted)
        r, next_sum = len(wanted.alpha), arrays[at.SIGNALS][at.FORCE_SUM_NEXT :]
        controller.force_law.integral = next_sum[:r]
        controller.force_law.forgo(relief.force, arrays[at.COLUMNS][at.GAIN, :r])
        self.tau[:] = relief.tau
        if len(relief.squeeze):
            arrays[at.SIGNALS][at.SQUEEZE] -= relief.squeeze[0]
        return controller.limits.given_up(wanted, relief, R, S @ relief.motion)

    def inputs(self) -> tuple[Measurement, Reference, Before]:
        """What the last computed tick was given, and what it began with."""
        n, k = self._model.nq, len(self._controller.chain.arms)
        data = self._arrays[at.INPUTS].copy()
        ends = np.cumsum([n, n, 6 * k, 16, 6, 6, 1, 1, 1])
        q, v, wrenches, X, V, A, squeeze, moved, size, alpha = np.split(
            data[: -at.STATE_SIZE], ends
        )
        touched = None
        if moved[0]:
            rows = self._arrays[at.TOUCHED_BEFORE][:-1].copy()
            touched = Touched(rows[:, :16].reshape(-1, 4, 4), rows[:, 16:22], rows[:, 22:])
        measurement = Measurement(q, v, wrenches.reshape(k, 6), touched)
        reference = Reference(
            pin.SE3(X.reshape(4, 4)), V, A, alpha[: int(size[0])], float(squeeze[0])
        )
        state = data[-at.STATE_SIZE :]
        force = state[at.FORCE_SUM : at.FORCE_SUM + int(state[at.FORCE_RANK])]
        before = Before(
            state[: at.TARE], force, state[at.TARE : at.BIAS], state[at.BIAS : at.FORCE_SUM],
            self._arrays[at.TERMS_BEFORE][:-1].copy(),
        )  # fmt: skip
        return measurement, reference, before

    def replay(self) -> Signals:
        """The wires of the last computed tick, worked out by the readable path."""
        controller = self._controller
        measurement, reference, then = self.inputs()
        motion, force, terms = controller.motion_law, controller.force_law, controller.terms
        now = motion.integral, force.integral, controller._tare, controller._bias
        how = controller.status, controller._reason, controller.given_up
        rows, s = terms.rows.copy(), Signals()
        try:
            motion.integral, force.integral = then.error_sum, then.force_sum
            controller._tare, controller._bias, terms.rows[:] = then.tare, then.bias, then.terms
            controller._take_in(measurement, reference, s)
            for stage in controller.STAGES:
                stage(controller, s)
        finally:
            motion.integral, force.integral, controller._tare, controller._bias = now
            controller.status, controller._reason, controller.given_up = how
            terms.rows[:] = rows
        return s

    def _bind(self) -> None:
        for row, array in self._arrays.items():
            self._bound[row, 0] = array.__array_interface__["data"][0]
            self._bound[row, 1 : 1 + array.ndim] = array.shape
        self.found = _found(self._arrays)
        self.acceleration = self._arrays[at.JOINT_VECTORS][3]

    def _repack(self, columns: dict[int, int]) -> None:
        """Make room for other numbers of columns, by the pair's number."""
        kept = (at.STATE, at.TAU, at.SIGNALS, at.TOUCHED, at.TERMS, at.JOINT_VECTORS)
        keep = {row: self._arrays[row] for row in kept}
        arrays, self._pairs = pack(self._controller, self._data, columns)
        self._arrays = arrays | keep
        self._bind()

    # --- before the kernel ---------------------------------------------------------------------

    def _move(self, touched: Touched | None) -> None:
        """Poses, twists and accelerations of the touched bodies; None: they rest in the world."""
        rows = self._arrays[at.TOUCHED][:-1]
        self._moved = touched is not None
        if touched is None:
            rows[:] = np.eye(4).ravel().tolist() + [0.0] * 12
            return
        count = len(rows)
        if len(touched.X_WE) != count or len(touched.V_E) != count or len(touched.A_E) != count:
            raise ValueError("one motion for each contact")
        rows[:, :16] = touched.X_WE.reshape(count, 16)
        rows[:, 16:22] = touched.V_E
        rows[:, 22:] = touched.A_E

    def _evaluate(self, measurement: Measurement) -> bool:
        """What only Python code can tell: N and n_γ of some pairs, Φ_e, b_e, V_e of some bodies.

        Returns False where the columns of a pair are dependent at this instant.
        """
        chain = self._controller.chain
        if chain.leader is None:
            return False  # only the readable path tells where the object is before the kernel
        frame = self._model.frames[chain.tips[chain.leader]]
        X_TO = chain.grasps[chain.leader].X_TO
        X_WO = self._data.oMi[frame.parentJoint] * frame.placement * X_TO
        s = chain.slices[chain.leader]
        V = self._data.J[:, s] @ measurement.v[s]
        V[:3] += np.cross(V[3:], X_WO.translation)
        touched = measurement.touched
        found: dict[int, Contact] = {}
        for number, pair, _ in self._pairs.elsewhere:
            if touched is None:
                contact = pair.contact(X_WO, V)
            else:
                contact = pair.contact(X_WO, V, pin.SE3(touched.X_WE[number]), touched.V_E[number])
            if not contact.split_is_unique:
                return False
            found[number] = contact
        table = self._pairs.table
        if any(contact.r != table[number, 2] for number, contact in found.items()):
            self._repack({number: contact.r for number, contact in found.items()})
        for number, _, first in self._pairs.elsewhere:
            contact = found[number]
            self._arrays[at.N_O][first : first + contact.r] = contact.N.T
            self._arrays[at.COLUMNS][at.N_GAMMA, first : first + contact.r] = contact.n_gamma
        if touched is not None:
            O = X_WO.translation  # noqa: E741
            for c, body in self._bodies:
                e = body.environment(
                    pin.SE3(touched.X_WE[c]), touched.V_E[c], touched.A_E[c], O
                )  # fmt: skip
                self._arrays[at.BODIES][c] = np.concatenate((e.Phi_e.ravel(), e.b_e, e.V_e))
        return True

    # --- compilation ---------------------------------------------------------------------------

    def _load(self) -> None:
        """Call the kernel once with data it refuses: now is the time to compile."""
        if getattr(self._kernel, "signatures", None):
            return
        none = np.full(self._model.nq, np.nan)
        six = np.zeros(6)
        with announced():
            self._kernel(
                self._bound, none, none, np.zeros((len(self._controller.chain.arms), 6)), np.eye(4),
                six, six, np.zeros(0), 0.0, False,
            )  # fmt: skip
        if hasattr(self._kernel, "disable_compile"):
            self._kernel.disable_compile()  # other types are converted or refused


def _found(arrays: dict[int, Array]) -> Found:
    s, columns = arrays[at.SIGNALS], arrays[at.COLUMNS]
    D, count = arrays[at.SQUARES][at.MOBILITY], bars(len(arrays[at.ARMS]))
    squeeze = s[at.SQUEEZE : at.SQUEEZE + 1] if count < 2 else np.zeros(count)

    def six(start: int) -> Array:
        return s[start : start + 6]

    return Found(
        J=arrays[at.J],
        f_meas=six(at.F_MEAS), bias_out=six(at.BIAS_OUT), f_c=six(at.F_C), V_O=six(at.V_O),
        X_WO=s[at.X_WO : at.X_WO + 16].reshape(4, 4), error=six(at.ERROR),
        free_error=six(at.FREE_ERROR), squeeze=squeeze,
        magnitudes=columns[at.ALPHA_MEAS], speeds=columns[at.SPEED], mobilities=D,
        rank=s[at.RANK : at.RANK + 1],
    )  # fmt: skip


@cache
def _kernel() -> Any:
    """The kernel, tied to the sources of all its parts: numba looks at one file's date only."""
    from osc_contact.kernels import tick

    stamp = 0
    for source in sorted(Path(tick.__file__).parent.glob("*.py")):
        stamp = zlib.crc32(source.read_bytes(), stamp)
    return tick.build(stamp)
