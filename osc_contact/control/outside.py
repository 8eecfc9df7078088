"""What Python evaluates between the parts of a tick: pairs, bodies and laws of the user's own."""

from __future__ import annotations

from math import isfinite
from typing import Any, Protocol

import numpy as np
import pinocchio as pin

from osc_contact.contacts.pairs import ContactPair
from osc_contact.control.friction import friction_wrenches
from osc_contact.control.laws import Laws
from osc_contact.control.model_row import ModelRow
from osc_contact.control.settings import Settings
from osc_contact.control.signals import Signals
from osc_contact.control.tick_records import TickRecords
from osc_contact.errors import ContactError
from osc_contact.interface import Measurement, Reference, Touched
from osc_contact.law import tables as at
from osc_contact.law import tick as law
from osc_contact.law.tables import ELSEWHERE, HELD
from osc_contact.spatial import Array

__all__ = ["Outside"]


class TickOwner(Protocol):
    """The controller whose tick it is: its records and the compiled law."""

    _records: TickRecords
    _limits: Any

    def _run(self, args: tuple[Any, ...], flags: int, begin: int, stop: int) -> int: ...

    def _hold(self, measurement: Measurement) -> Array: ...
    def _take_records(self, records: TickRecords) -> None: ...


class Outside:
    """Calls the parts of a tick one by one, and Python code in between.

    Attributes:
        needed: whether there is anything to call.
        row: as packed at first, for the controller that is made with it.
    """

    def __init__(self, settings: Settings, laws: Laws) -> None:
        self.settings, self.laws = settings, laws
        self.row = self.pack()
        self._given = [(number, pair) for number, pair, _ in self.row.pairs.elsewhere]
        kinds = self.row.head.bodies
        self._bodies = [
            (c, settings.bodies[c])
            for c, one in enumerate(kinds)
            if one.kind == ELSEWHERE and one.same == c
        ]
        own = laws.force or laws.motion or laws.structure
        self.needed = bool(self._given or self._bodies or own)

    def pack(self, columns: dict[int, int] | None = None) -> ModelRow:
        """The MODEL row; `columns`: how many of N the given pairs have, by number."""
        return ModelRow(self.settings, dict(columns or {}))

    def tick(
        self,
        controller: TickOwner,
        measurement: Measurement,
        reference: Reference,
        args: tuple[Any, ...],
        flags: int,
    ) -> Exception | None:
        """One tick; torques and status go to its records.

        Args:
            controller: whose tick. measurement, reference: of the tick.
            args, flags: of the compiled law.

        Returns:
            What code of the user's own raised: then the posture is held.
        """
        laws = self.laws

        def run(begin: int, stop: int, more: int = 0) -> bool:
            controller._run(args, flags | more, begin, stop)
            return bool(controller._records.status[0] != HELD)

        if not run(law.LOOK, law.MEASURE, law.PARTIAL if self._given else 0):
            return None
        rows = controller._records
        try:
            if self._given and rows.active.any():
                evaluated = self._evaluate(rows, measurement)
                columns = {c: N.shape[1] for c, (N, _, _) in evaluated.items()}
                if any(r != rows.row.pairs.table[c][2] for c, r in columns.items()):
                    self._repack(controller, columns)
                    rows = controller._records
                    if not run(law.LOOK, law.MEASURE):
                        return None
                self._put(rows, evaluated)
            if self._bodies and measurement.touched is not None:
                self._answer(rows, measurement)
            misfit = np.size(reference.alpha_d) != len(rows.columns) and rows.memory.engaged
            if misfit and not run(law.LOOK, law.MEASURE):
                return None
            if not run(law.MEASURE, law.COMMAND, law.OWN_FORCE if laws.force else 0):
                return None
            w, given = rows.work, 0
            if laws.force is not None:
                r = int(w.rank)
                alpha = laws.command_force(w.alpha_d[:r].copy(), w.alpha_meas[:r].copy())
                w.alpha_u[:r], given = alpha, given | law.OWN_FORCE
            if laws.motion is not None:
                X, V = pin.SE3(w.X_WO.copy()), w.V_O.copy()
                w.a_u[:], given = laws.command_motion(reference, X, V), given | law.OWN_MOTION
            if not run(law.COMMAND, law.ALLOCATE, given):
                return None
            if laws.structure is not None:
                self._structure(controller)
        except Exception as error:  # whatever the user's code raises ends as a status
            controller._hold(measurement)
            return error
        run(law.ALLOCATE, law.END)
        return None

    def _evaluate(self, rows: TickRecords, measurement: Measurement) -> dict[int, Any]:
        """N (6, r), n_γ (r,) and N_μ − N (6, r) of the pairs that only Python knows, where on."""
        X, V, evaluated = pin.SE3(rows.X_WO.copy()), rows.V_O.copy(), {}
        touched = measurement.touched
        for number, pair in self._given:
            if not rows.active[number]:
                continue
            if touched is None:
                contact = pair.contact(X, V)
            else:
                X_WE = pin.SE3(np.asarray(touched.X_WE[number], dtype=float))
                contact = pair.contact(X, V, X_WE, touched.V_E[number])
            N, n_gamma = contact.N, contact.n_gamma
            if not isfinite(np.vdot(N, N) + np.vdot(n_gamma, n_gamma)):
                raise ContactError(f"{pair.name}: N or n_γ is not finite")
            if not contact.split_is_unique:
                N, n_gamma = N @ contact.R, n_gamma @ contact.R
            evaluated[number] = (
                N,
                n_gamma,
                self._friction_wrenches(number, pair, N.shape[1], X, V, touched),
            )
        return evaluated

    def _friction_wrenches(
        self,
        number: int,
        pair: ContactPair,
        r: int,
        X_WO: pin.SE3,
        V_O: Array,
        touched: Touched | None,
    ) -> Array:
        """N_μ − N (6, r) of a pair that only Python knows."""
        if self.settings.friction is None:
            return np.zeros((6, r))
        if touched is not None:
            here = slice(number, number + 1)
            touched = Touched(touched.X_WE[here], touched.V_E[here], touched.A_E[here])
        wrenches = friction_wrenches(self.settings.friction, [pair], X_WO, V_O, touched)
        if wrenches.shape[1] != r:
            raise ContactError(
                f"{pair.name}: {wrenches.shape[1]} points of contact, {r} independent "
                "forces; friction needs one for each"
            )
        return wrenches

    def _put(self, rows: TickRecords, evaluated: dict[int, Any]) -> None:
        for number, _, first in rows.row.pairs.elsewhere:
            if number in evaluated:
                N, n_gamma, wrenches = evaluated[number]
                part = slice(first, first + N.shape[1])
                rows.given_columns[0][part], rows.given_columns[1][part] = N.T, n_gamma
                rows.given_columns[2][part] = wrenches.T

    def _answer(self, rows: TickRecords, measurement: Measurement) -> None:
        touched, O = measurement.touched, rows.work.O.copy()  # noqa: E741
        assert touched is not None
        for c, body in self._bodies:
            assert body is not None
            e = body.environment(pin.SE3(touched.X_WE[c]), touched.V_E[c], touched.A_E[c], O)
            rows.bodies.answer[c] = np.concatenate((e.Phi_e.ravel(), e.b_e, e.V_e))

    def _repack(self, controller: TickOwner, changed: dict[int, int]) -> None:
        """Make room for other numbers of columns; the rest of the memory goes on."""
        old = controller._records
        columns = {**old.row.pairs.given, **changed}
        new = TickRecords(self.pack(columns))
        begin = at.MEMORY.dtype.fields["layout"][0].itemsize
        same = int(new.memory.layout[list(at.MEMORY.tables).index("columns")])
        new.memory_bytes[begin:same] = old.memory_bytes[begin:same]
        owners = np.asarray(new.row.pairs.owners, dtype=int)
        new.column_memory.closed[:] = new.contacts.phase[owners] == 2
        controller._take_records(new)
        controller._limits = None

    def _structure(self, controller: TickOwner) -> None:
        """η̇_c and f_S of the own structure law, into the turned energy coordinates.

        A law with `fill(records)` writes x and f_S of WORK itself, without signals: 0.1 ms a tick
        instead of 1 ms.
        """
        rows = controller._records
        fill = getattr(self.laws.structure, "fill", None)
        if fill is not None:
            fill(rows)
            return
        signals = Signals(self.settings, rows, 0.0, rows.torques)
        eta, f_S = self.laws.command_structure(signals)
        state = signals.state
        turn, back = rows.reflection(), rows.motions()
        rows.work.x[:] = turn @ np.linalg.solve(back, state.S @ eta + state.sigma)
        H = state.S.T @ state.metric @ state.S
        wrench = state.metric @ state.S @ np.linalg.solve(H, f_S)
        rows.work.f_S[:] = turn @ (back.T @ wrench)
