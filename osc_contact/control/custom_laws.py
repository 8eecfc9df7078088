"""Laws, pairs and bodies in Python, evaluated between the compiled parts of a tick."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import pinocchio as pin
from pinocchio import SE3

from osc_contact.contacts.pairs import ContactPair
from osc_contact.contacts.pairs.pair import has_known_points
from osc_contact.control.controller_settings import Settings
from osc_contact.control.packing import pack_model
from osc_contact.control.records import TickRecords
from osc_contact.control.signals import Signals
from osc_contact.control.status import Phase
from osc_contact.dynamics.environment import Body
from osc_contact.errors import ContactError, InvalidInputError
from osc_contact.interface import Measurement, Reference, Touched
from osc_contact.law import records as at
from osc_contact.law import tick as law
from osc_contact.law.nested import View
from osc_contact.spatial import Array, as_array, classical_to_spatial, pose_error

ForceCommand = Callable[[Array, Array], Array]
MotionCommand = Callable[[Reference, SE3, Array], Array]
StructureCommand = Callable[[Signals], tuple[Array, Array]]


@dataclass(frozen=True)
class Laws:
    """Laws of the user in place of the controller's own; None: the controller's own.

    Attributes:
        force: α_u = force(α_d, α_meas), (r,) magnitudes of the independent columns of N (N).
        motion: p̈_u = motion(reference, X_WO, V_O), classical acceleration (6,) of the object at O
            in world axes (m/s², rad/s²), from the reference, the object's pose and twist.
        structure: (η̇_c, f_S) = structure(signals), (d,) each, in place of the motion filter and
            the control structure, eqs. 24 and 21; `signals` are those of the tick up to there.

    Example:
        >>> from numpy.typing import NDArray
        >>> Forces = NDArray[np.float64]
        >>> def push(desired: Forces, measured: Forces) -> Forces:
        ...     return desired + 0.2 * (desired - measured)
        >>> rig = osc.build_rig(osc.load_scenario("two_contact_rod"))
        >>> controller = osc.Controller(rig.chain, rig.pairs, laws=osc.Laws(force=push))
    """

    force: ForceCommand | None = None
    motion: MotionCommand | None = None
    structure: StructureCommand | None = None


def _checked_result(law: str, returned: Any, shape: tuple[int, ...], expected: str) -> Array:
    """Check the result of a custom law; return it as an array.

    Args:
        law: name of the law.
        returned: result of the user's function.
        shape: required shape.
        expected: description of the required result for the message.

    Raises:
        InvalidInputError: another shape, or numbers that are not finite.
    """
    try:
        return as_array(law, returned, shape)
    except InvalidInputError as error:
        text = f"the {law} law returned {returned}: return {expected}"
        raise InvalidInputError(text) from error


def force_law(make: Callable[[], ForceCommand]) -> Callable[[Any], Any]:
    """Replace the force law of fig. 5 by α_u = law(α_d, α_meas).

    Args:
        make: class, or function without arguments, that is called once for every controller, so
            that laws with a state do not share it. Its result is called in every tick, see
            `Laws.force`; if this call returns an invalid result, the controller holds the posture,
            and `Controller.reason` has the cause.

    Returns:
        A function from `Controller` to `Controller`, for the argument ``install`` of
        `osc_contact.run`.
    """
    return lambda controller: controller.with_laws(force=make())


def motion_law(make: Callable[[], MotionCommand]) -> Callable[[Any], Any]:
    """Replace the motion law by p̈_u = law(reference, X_WO, V_O).

    Args:
        make: class, or function without arguments, that is called once for every controller. Its
            result is called in every tick, see `Laws.motion`.

    Returns:
        A function from `Controller` to `Controller`, for the argument ``install`` of
        `osc_contact.run`.
    """
    return lambda controller: controller.with_laws(motion=make())


@dataclass
class TickParts:
    """Arguments of one tick whose parts are run one after the other.

    Attributes:
        records: records of the controller.
        inputs, switches: arguments of the law, see `inputs.read_tick`.
    """

    records: TickRecords
    inputs: tuple[Array, ...]
    switches: int

    def run(self, begin: int, stop: int, flags: int = 0) -> bool:
        """Run consecutive parts of the tick.

        Args:
            begin: number of the first part.
            stop: number of the part after the last one.
            flags: switches in addition to those of the tick.

        Returns:
            Whether they were computed; else the tick has ended HELD.
        """
        self.records.run(self.inputs, self.switches | flags, begin, stop)
        return bool(self.records.memory.status != at.HELD)


class CustomParts:
    """Ticks of a controller with the user's Python code, called between the compiled parts.

    Attributes:
        needed: True if the controller has pairs, bodies or laws that only Python can evaluate.
    """

    def __init__(self, settings: Settings, laws: Laws, head: View) -> None:
        """Find the pairs and bodies that the compiled law cannot evaluate.

        Python evaluates them in each tick, and the user's functions in `laws`; `needed` is whether
        there is any of them.

        Args:
            settings: settings of the controller.
            laws: the user's functions for commands of force and motion.
            head: view of MODEL, in which such pairs have the kind GIVEN and such bodies the kind
                ELSEWHERE. `same` of a body is the index of the first contact with it, so that each
                is evaluated once.
        """
        self.settings = settings
        self.laws = laws
        #: pairs that Python evaluates, with the index of their contact
        self._pairs: list[tuple[int, ContactPair]] = [
            (number, settings.contacts[number])
            for number in np.flatnonzero(head.pairs.kind == at.GIVEN).tolist()
        ]
        #: bodies that Python evaluates, with the index of their first contact
        self._bodies: list[tuple[int, Body]] = [
            (number, body)
            for number, (row, body) in enumerate(zip(head.bodies, settings.bodies, strict=True))
            if row.kind == at.ELSEWHERE and row.same == number and body is not None
        ]
        self.needed = bool(self._pairs or self._bodies) or laws != Laws()

    def columns(self, model: View) -> dict[int, int]:
        """Number of columns of N of each custom pair in a MODEL, by the index of the pair."""
        return {number: int(model.pairs[number].count) for number, _ in self._pairs}

    def tick(
        self,
        parts: TickParts,
        measurement: Measurement,
        reference: Reference,
        replace: Callable[[TickRecords], None],
    ) -> Exception | None:
        """Compute one tick; torques and status go to the records.

        Args:
            parts: stages of the tick, none of which was run yet.
            measurement, reference: inputs of the tick.
            replace: function that is called with new records of the controller if a custom pair has
                changed its number of columns of N.

        Returns:
            Exception that custom code raised, for which the caller holds the tick, or None.
        """
        if not parts.run(at.LOOK, at.MEASURE, law.PARTIAL if self._pairs else 0):
            return None
        begin = at.MEASURE
        try:
            if not self._fill_contacts(parts, measurement, reference, replace):
                return None
            if self.laws != Laws():
                if not self._command_by_laws(parts, reference):
                    return None
                begin = at.ALLOCATE
        except Exception as error:  # any exception of custom code becomes a status
            return error
        parts.run(begin, at.END)
        return None

    def _fill_contacts(
        self,
        parts: TickParts,
        measurement: Measurement,
        reference: Reference,
        replace: Callable[[TickRecords], None],
    ) -> bool:
        """Evaluate custom pairs and bodies, and write their results to WORK.

        Fills `N`, `n_gamma` and `point` of the pairs' columns and `answer` of the bodies. If a pair
        has another number of columns than before, records of another size replace the records
        first.

        Args:
            parts: stages of the tick, of which LOOK has been run.
            measurement, reference: inputs of the tick.
            replace: function that is called with the new records.

        Returns:
            False if the tick has ended HELD.
        """
        evaluated = self._evaluate_pairs(parts.records, measurement) if self._pairs else {}
        columns = {number: N.shape[1] for number, (N, _, _) in evaluated.items()}
        counts = parts.records.model.pairs.count
        if any(r != counts[number] for number, r in columns.items()):
            parts.records = self._resized_records(parts.records, columns)
            replace(parts.records)
            if not parts.run(at.LOOK, at.MEASURE):
                return False
        records = parts.records
        for number, (N, n_gamma, points) in evaluated.items():
            first = records.model.pairs.first[number]
            rows = records.work.columns[first : first + N.shape[1]]
            rows.N = N.T
            rows.n_gamma = n_gamma
            if points is not None:
                rows.point = points
        if self._bodies and measurement.touched is not None:
            self._evaluate_bodies(records, measurement.touched)
        misfit = np.size(reference.alpha_d) != len(records.work.columns)
        if misfit and records.memory.engaged:
            return parts.run(at.LOOK, at.MEASURE)  # ends the tick HELD, with its reason
        return True

    def _command_by_laws(self, parts: TickParts, reference: Reference) -> bool:
        """Run the parts MEASURE and COMMAND of the tick with the custom laws.

        A custom force law fills `alpha_u` of WORK, a motion law `a_u`, a structure law
        `acceleration_t` and `f_S`.

        Args:
            parts: the tick, with contacts placed.
            reference: reference of the tick.

        Returns:
            False if the tick has ended HELD.
        """
        laws = self.laws
        force = law.OWN_FORCE if laws.force else 0
        motion = law.OWN_MOTION if laws.motion else 0
        if not parts.run(at.MEASURE, at.COMMAND, force):
            return False
        work = parts.records.work
        if laws.force is not None:
            r = int(work.rank)
            returned = laws.force(work.alpha_d[:r].copy(), work.alpha_meas[:r].copy())
            words = f"{r} finite numbers, one for each column of N"
            work.alpha_u[:r] = _checked_result("force", returned, (r,), words)
        if laws.motion is not None:
            X_WO = SE3(work.X_WO)
            V_O = work.V_O.copy()
            a = _checked_result(
                "motion", laws.motion(reference, X_WO, V_O), (6,), "six finite numbers"
            )
            work.a_u[:] = classical_to_spatial(a, V_O)
        if not parts.run(at.COMMAND, at.ALLOCATE, force | motion):
            return False
        if laws.structure is not None:
            self._apply_structure_law(parts.records)
        return True

    def _evaluate_pairs(
        self, records: TickRecords, measurement: Measurement
    ) -> dict[int, tuple[Array, Array, Array | None]]:
        """Evaluate the active custom pairs at the object's pose in WORK.

        Args:
            records: records of the tick.
            measurement: measurement with the touched bodies' motion.

        Returns:
            For each pair, by its index, N (6, r), n_γ (r,) and the points of contact (r, 3)
            relative to O in world axes (m), or None for the points if the pair does not know them.

        Raises:
            ContactError: N or n_γ is not finite, or there is not one point for each column.
        """
        X_WO = SE3(records.work.X_WO)
        V_O = records.work.V_O.copy()
        touched = measurement.touched
        results = {}
        for number, pair in self._pairs:
            if not records.memory.contacts.active[number]:
                continue
            # pose and twist of the touched body; without a measurement the pair's defaults, at rest
            face: tuple[SE3, Array] | tuple[()] = ()
            if touched is not None:
                X_WE = SE3(np.asarray(touched.X_WE[number], dtype=float))
                face = X_WE, touched.V_E[number]
            contact = pair.contact(X_WO, V_O, *face)
            columns = np.vstack((contact.N, contact.n_gamma))
            if not np.isfinite(columns).all():
                raise ContactError(f"{pair.name}: N or n_γ is not finite")
            # the law needs the columns of all points: N_all = N R
            if not contact.split_is_unique:
                columns = columns @ contact.R
            N = columns[:6]
            points = None
            if has_known_points(pair):
                points = pair.points_of_contact(X_WO, *face[:1]).T - X_WO.translation
                if len(points) != N.shape[1]:
                    raise ContactError(
                        f"{pair.name}: {len(points)} points of contact, {N.shape[1]} "
                        "independent forces; friction needs one for each"
                    )
            results[number] = N, columns[6], points
        return results

    def _evaluate_bodies(self, records: TickRecords, touched: Touched) -> None:
        """Evaluate the custom bodies, and write Φ_e, b_e and V_e (eq. 14) to `answer` of WORK.

        Args:
            records: records of the tick, with the point O (m) in WORK.
            touched: measured motion of the touched bodies.
        """
        p_O = records.work.p_O.copy()
        for number, body in self._bodies:
            X_WE = SE3(touched.X_WE[number])
            environment = body.environment(X_WE, touched.V_E[number], touched.A_E[number], p_O)
            records.work.bodies.answer[number] = (
                *environment.Phi_e.flat,
                *environment.b_e,
                *environment.V_e,
            )

    def _resized_records(self, old: TickRecords, changed: dict[int, int]) -> TickRecords:
        """Make records with other numbers of columns of N; copy the states that do not depend on N.

        MEMORY begins with its layout, which depends on the number of columns, and ends with the
        table of the columns. The bytes between the two are copied; the columns begin anew, as
        closed where their contact is closed.

        Args:
            old: records of the controller.
            changed: new numbers of columns by the index of the pair.

        Returns:
            The new records.
        """
        columns = {**self.columns(old.model), **changed}
        new = TickRecords(pack_model(self.settings, columns))
        begin = at.MEMORY.dtype.fields["layout"][0].itemsize
        columns_at = int(new.memory.layout[at.MEMORY.start("columns")])
        new.memory_bytes[begin:columns_at] = old.memory_bytes[begin:columns_at]
        phase = new.memory.contacts.phase[new.model.columns.contact]
        new.memory.columns.closed[:] = phase == Phase.CLOSED
        return new

    def _apply_structure_law(self, records: TickRecords) -> None:
        """Evaluate the custom structure law, and convert η̇_c and f_S to turned energy coordinates.

        The law gives the filtered acceleration η̇_c (d,) and the generalised force f_S (d,) on the
        object along its d free motions S (6, d), both in the coordinates of `state.S`. Fills of
        WORK `acceleration_t`, S η̇_c + σ (6,), and `f_S` (6,), a wrench whose components along S
        are f_S. A law with a method `fill(records)` writes both by itself, without signals, which
        takes 0.1 ms instead of 1 ms.

        Args:
            records: records after the motion law of the tick.

        Raises:
            InvalidInputError: the law returns another shape, or numbers that are not finite.
        """
        fill = getattr(self.laws.structure, "fill", None)
        if fill is not None:
            fill(records)
            return
        signals = Signals(self.settings, records)
        state = signals.state
        words = f"η̇_c and f_S, {state.d} finite numbers each"
        structure: Any = self.laws.structure
        eta, f_S = _checked_result("structure", structure(signals), (2, state.d), words)
        turn = records.reflection()  # energy coordinates to locked axes
        to_motions = records.motions()  # energy coordinates to motions at O
        acceleration = state.S @ eta + state.sigma
        records.work.acceleration_t[:] = turn @ np.linalg.solve(to_motions, acceleration)
        # the wrench f with Sᵀf = f_S in the metric's image of S
        weighed = state.metric @ state.S
        wrench = weighed @ np.linalg.solve(state.S.T @ weighed, f_S)
        records.work.f_S[:] = turn @ (to_motions.T @ wrench)


# Impedance and admittance control as `Laws`, for contacts without a model.
#
# Neither decouples forces from motions: both make the object respond to all wrenches like a mass
# with a damper and a spring, so that the force on a surface depends on the position of the surface.
# They replace the motion filter and the control structure (eqs. 24 and 21); references, contact
# phases, wrist readings, torque allocation and limits are unchanged. Contacts only determine the
# directions of desired forces.
#
# Wrenches and motions are at O in world axes; internally, in the law's energy coordinates.


def impedance(stiffness: npt.ArrayLike = (1000.0, 100.0), damping_ratio: float = 0.7) -> Laws:
    """Impedance control with the arms' own inertia, without feedback of forces.

        F = Λ A_d + μ + p + D (V_d − V) + K e + N α_d

    so that Λ ë + D ė + K e = f_c − N α_d, e = x_d − x. The force on a surface at the position of
    the reference is α_d, and K δ more on a surface that is nearer by δ. N α_d has the same effect
    as a set point K⁻¹N α_d inside the surface. D = 2ζ L (L⁻¹ K L⁻ᵀ)^½ Lᵀ with Λ = L Lᵀ gives every
    mode the damping ratio ζ in every posture.

    Args:
        stiffness: K, of positions (N/m) and angles (N m/rad), or (6,) along and about the world's
            axes; ≥ 0.
        damping_ratio: ζ ≥ 0.

    Raises:
        InvalidInputError: another number of values, or one out of bounds.

    Source: N. Hogan, Impedance control: an approach to manipulation, ASME J. Dynamic Systems,
    Measurement, and Control 107, 1985. C. Ott, Cartesian Impedance Control of Redundant and
    Flexible-Joint Robots, Springer, 2008 (own inertia). A. Albu-Schäffer, C. Ott, U. Frese,
    G. Hirzinger, Cartesian impedance control of redundant robots, ICRA 2003 (D).
    """
    ratio = _six_values("damping_ratio", [damping_ratio] * 2)
    return Laws(structure=_Impedance(_six_values("stiffness", stiffness), float(ratio[0])))


def admittance(
    mass: npt.ArrayLike = (5.0, 0.1),
    damping: npt.ArrayLike = (400.0, 8.0),
    stiffness: npt.ArrayLike = (1000.0, 100.0),
    frequency: float = 10.0,
) -> Laws:
    """Admittance control: measured forces move the set point of a position controller.

        M c̈ + D ċ + K c = N α_d − f,   x_r = x_d + c
        F = Λ (A_r + 2ω (V_r − V) + ω² (x_r − x)) + μ + p + f

    f is the wrist reading without weight and velocity terms. On a surface of stiffness k_e,
    D = 1.4 √(k_e M) gives the contact the damping ratio 0.7, if x follows x_r without delay. With
    K > 0 the force depends on the position of the surface; with K = 0 it settles at α_d on any
    surface, and without contact the object drifts at α_d / D.

    The law has a state; give it as ``laws=lambda: osc.admittance(...)``, one for each controller.

    Args:
        mass: M > 0 (kg; kg m²).
        damping: D ≥ 0 (N s/m; N m s/rad).
        stiffness: K ≥ 0 (N/m; N m/rad). Each of positions and angles, or (6,) along and about the
            world's axes.
        frequency: ω/2π > 0 (Hz) of the position controller.

    Raises:
        InvalidInputError: another number of values, or one out of bounds.

    Source: L. Villani, J. De Schutter, Force control, in: Springer Handbook of Robotics, 2nd ed.,
    2016, chapter 9.2.
    """
    M = _six_values("mass", mass, positive=True)
    D = _six_values("damping", damping)
    K = _six_values("stiffness", stiffness)
    rate = _six_values("frequency", [frequency] * 2, positive=True)
    return Laws(structure=_Admittance(M, D, K, 2.0 * np.pi * float(rate[0])))


def _six_values(name: str, numbers: npt.ArrayLike, positive: bool = False) -> Array:
    """Expand a parameter of an impedance to (6,): a linear and an angular value, or all six.

    Args:
        name: name of the parameter, for messages.
        numbers: two or six numbers.
        positive: True if 0 is not allowed.

    Raises:
        InvalidInputError: another number of values, or a value out of bounds.
    """
    values = as_array(name, numbers, (None,))
    if len(values) == 2:
        values = np.repeat(values, 3)
    values = as_array(name, values, (6,))
    if values.min() < 0.0 or (positive and not values.all()):
        raise InvalidInputError(
            f"{name} = {values.tolist()}; give numbers {'> 0' if positive else '≥ 0'}"
        )
    return values


class _Structure(ABC):
    """Base of structure laws that command an acceleration and an additional wrench."""

    def __call__(self, signals: Any) -> Any:
        """Refuse a call with signals: a controller calls `fill` instead.

        Raises:
            InvalidInputError: always.
        """
        raise InvalidInputError(
            f"{type(self).__name__.strip('_').lower()} works on the records of a tick, not on its "
            "signals; give it to a controller, as osc.Laws(structure=…)"
        )

    def fill(self, records: TickRecords) -> None:
        """Write `acceleration_t` (the expected acceleration) and `f_S` of WORK.

        With the commanded acceleration x and the additional wrench f, damping included,
        f_S = Λ x + b + f and the expected acceleration is x + Λ⁻¹(f − f_meas), along the free axes.

        Args:
            records: records of the tick, whose parts before ALLOCATE have been run.
        """
        work = records.work
        m = int(work.locked)
        turn = records.reflection() @ records.motions().T  # wrenches at O to locked axes
        Lambda = work.Lambda
        columns = work.columns[work.chosen[: int(work.count)]]
        reading = work.f_meas - work.bias_out
        A, f = self.command(work, columns.alpha_d @ columns.N, reading)
        f = turn @ (f + records.memory.f_bias)
        rate = np.linalg.solve(turn.T, work.V_D - work.V_O)
        f[m:] += self.damp(Lambda[m:, m:], turn[m:], rate[m:])
        x = np.linalg.solve(turn.T, classical_to_spatial(A, work.V_O))
        x[:m] = work.sigma[:m]
        work.f_S[:] = Lambda @ x + work.chain_bias + f
        x[m:] += np.linalg.solve(Lambda[m:, m:], (f - turn @ reading)[m:])
        work.acceleration_t[:] = x
        work.force_next[:] = 0.0  # the integrals of the replaced laws stay at zero
        work.motion_next[:] = 0.0

    @abstractmethod
    def command(self, work: View, desired: Array, reading: Array) -> tuple[Array, Array]:
        """Compute the commanded motion and the additional wrench, at O in world axes.

        Args:
            work: WORK of the tick.
            desired: (6,) N α_d (N, N m).
            reading: (6,) wrist reading less bias (N, N m).

        Returns:
            Classical acceleration (6,) (m/s², rad/s²) and wrench (6,) (N, N m).
        """

    def damp(self, Lambda: Array, turn: Array, rate: Array) -> Array:
        """Compute the damping wrench (d,) for the error rate ė, along the axes that are not locked.

        Args:
            Lambda: (d, d) inertia of arms and object.
            turn: (d, 6) map of wrenches from world axes.
            rate: (d,) error rate ė.
        """
        return np.zeros(len(rate))


@dataclass(eq=False)
class _Impedance(_Structure):
    """Structure law of `impedance`.

    Attributes:
        K: (6,) stiffness along and about the world's axes (N/m, N m/rad).
        ratio: damping ratio ζ.
    """

    K: Array
    ratio: float

    def command(self, work: View, desired: Array, reading: Array) -> tuple[Array, Array]:
        """Command A_D and the spring force K e + N α_d.

        Args:
            work: WORK of the tick, with A_D and the pose error e.
            desired: (6,) N α_d (N, N m).
            reading: (6,) wrist reading, which is not used.

        Returns:
            Classical acceleration (6,) (m/s², rad/s²) and wrench (6,) (N, N m), at O.
        """
        return work.A_D, self.K * work.error + desired

    def damp(self, Lambda: Array, turn: Array, rate: Array) -> Array:
        """Compute the damping wrench D ė (d,) with D = 2ζ L (L⁻¹ K L⁻ᵀ)^½ Lᵀ, Λ = L Lᵀ.

        Args:
            Lambda: (d, d) inertia of arms and object.
            turn: (d, 6) map of wrenches from world axes.
            rate: (d,) error rate ė.
        """
        L = np.linalg.cholesky(Lambda)
        half = np.linalg.solve(L, turn * np.sqrt(self.K))  # half halfᵀ = L⁻¹ K L⁻ᵀ
        squares, U = np.linalg.eigh(half @ half.T)
        U = L @ U
        return 2.0 * self.ratio * U @ (np.sqrt(np.maximum(squares, 0.0)) * (U.T @ rate))


@dataclass(eq=False)
class _Admittance(_Structure):
    """Structure law of `admittance`.

    Attributes:
        M, D, K: (6,) mass, damping and stiffness along and about the world's axes.
        omega: ω of the position controller (rad/s).
        c, rate: (6,) offset of the set point and its rate (m, rad; m/s, rad/s).
    """

    M: Array
    D: Array
    K: Array
    omega: float

    def __post_init__(self) -> None:
        """Begin with an offset of zero, at rest."""
        self.c = self.rate = np.zeros(6)

    def command(self, work: View, desired: Array, reading: Array) -> tuple[Array, Array]:
        """Integrate M c̈ + D ċ + K c = N α_d − f over a tick; command the motion to x_d + c.

        The additional wrench f compensates the reading, so that contact forces do not move the
        object otherwise.

        Args:
            work: WORK of the tick, with the period, the reference and the object's motion.
            desired: (6,) N α_d (N, N m).
            reading: (6,) wrist reading f less bias (N, N m).

        Returns:
            Classical acceleration (6,) (m/s², rad/s²) and wrench (6,) (N, N m), at O.
        """
        dt = float(work.dt)
        before = self.rate
        pushed = self.M * before + dt * (desired - reading - self.K * self.c)
        self.rate = pushed / (self.M + dt * (self.D + dt * self.K))  # implicit Euler: stable
        self.c = self.c + dt * self.rate
        R_c = pin.exp3(self.c[3:]) @ work.X_WD[:3, :3]
        X_WC = SE3(R_c, work.X_WD[:3, 3] + self.c[:3])
        e = pose_error(X_WC, SE3(work.X_WO))
        e_dot = work.V_D + self.rate - work.V_O
        A = work.A_D + (self.rate - before) / dt
        return A + 2.0 * self.omega * e_dot + self.omega**2 * e, reading
