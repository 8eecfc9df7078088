"""Pairs defined by functions of the user: of gaps alone, or of all quantities of a pair.

`CompiledPair._rows` has the parameters of the pair's functions as SHAPE rows, 16 numbers a row.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from dataclasses import field
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt
import pinocchio as pin
from pinocchio import SE3

from osc_contact.contacts.contact import Contact
from osc_contact.contacts.pairs.keys import Extent, store
from osc_contact.contacts.pairs.law_pair import PairRow
from osc_contact.contacts.pairs.pair import Bodies
from osc_contact.contacts.pairs.register import PackagedPair, register_pair
from osc_contact.errors import ContactError, InvalidInputError, missing
from osc_contact.law.jit import PLAIN_PYTHON, call_address
from osc_contact.law.records import FUNCTION
from osc_contact.spatial import Array, as_array, cross_twist, norm

# Contacts defined by gap functions, whose derivatives are N and n_γ.

# Eighth-order central differences at the steps ±1 … ±4.
_STEPS = np.array([1.0, 2.0, 3.0, 4.0])
_FIRST = np.array([672.0, -168.0, 32.0, -3.0]) / 840.0
_SECOND = np.array([8064.0, -1008.0, 128.0, -9.0]) / 5040.0


@register_pair()
class GapFunctions(PackagedPair):
    """Pair of r smooth functions of the relative pose that are zero in contact, 0 ≤ r ≤ 6.

    N = −∂g/∂ξ for relative displacements ξ at O and, as g(X_EA) depends on the relative pose only,
    n_γ = Nᵀ(V_E × V_rel) + d²g/ds² along the motion of constant relative twist V_rel. Both are
    computed by central differences of eighth order (48 and 8 evaluations), in which the object is
    turned about its own origin by `step` (rad) and moved by `step · length` (m). For functions
    with features of size `length` or more the truncation error is below 1e-15 of g (1e-8 for a
    tenth of that size), and the rounding error is 1e-16/step² = 3e-13 of g times (speed/length)².
    g must be smooth up to 4 steps on both sides of contact.

    Attributes:
        gap: function of the pose of the object in the environment frame that returns the gaps (r,)
            (m or rad), which decrease as the object moves into the environment.
        length: size of the features of the geometry (m), such as the least radius of curvature.
        step: step of the differences (rad, and share of `length`).
        name: name in messages and recordings.

    Example:
        >>> def above(X_EA: pin.SE3) -> list[float]:
        ...     return [X_EA.translation[2] - 0.2]  # the object's origin on the plane z = 0.2 m
        >>> pair = osc.GapFunctions(above, length=0.1)
        >>> print(pair.gaps(pin.SE3.Identity()))
        [-0.2]
    """

    gap: Callable[[SE3], npt.ArrayLike]
    length: Extent = 0.1
    step: float = 0.02
    name: str = "gap_functions"

    def _make(self) -> None:
        """Check the step of the differences."""
        if not 1e-5 <= self.step <= 0.3:
            raise InvalidInputError(f"{self.name}.step = {self.step}; give 1e-5 … 0.3")

    def _contact(self, b: Bodies) -> Contact:
        """N and n_γ from the first and second differences of the gaps g (r,), at O in world axes.

        N (6, r) = −∂g/∂x for displacements x of the object, and n_γ (r,) is d²g/dt² along a
        constant relative twist, plus the part by the rotation of N with the environment.

        Args:
            b: poses and twists of object and environment at one instant.
        """
        X_EA = b.X_E.actInv(b.X_A)
        to_E = np.kron(np.eye(2), b.X_E.rotation.T)
        units = np.repeat([self.length, 1.0], 3)
        slopes = [self._gap_derivatives(X_EA, xi)[0] for xi in np.diag(units)]
        N = -to_E.T @ (np.array(slopes) / units[:, None])  # at O
        V_rel = b.V_rel
        xi = to_E @ V_rel
        speed = norm(xi / units)  # rate along the motion in units of `step` (1/s)
        bend = self._gap_derivatives(X_EA, xi / speed)[1] * speed**2 if speed else 0.0
        return Contact(N, cross_twist(b.V_E, V_rel) @ N + bend, name=self.name)

    def _gaps(self, X_EA: SE3) -> Array:
        return as_array(f"{self.name}.gap(X_EA)", self.gap(X_EA), (None,))

    def _gap_derivatives(self, X_EA: SE3, xi: Array) -> tuple[Array, Array]:
        """First and second derivatives (r,) of the gaps along a motion of constant twist.

        Args:
            X_EA: pose of the object.
            xi: (6,) twist at A's origin, E's axes.
        """
        at_A = SE3(np.eye(3), X_EA.translation)
        rotation = SE3(X_EA.rotation, np.zeros(3))

        def g(s: float) -> Array:
            return self._gaps(at_A * pin.exp6(s * xi) * rotation)

        forward = np.array([g(k * self.step) for k in _STEPS])
        backward = np.array([g(-k * self.step) for k in _STEPS])
        first = _FIRST @ (forward - backward) / self.step
        return (first, _SECOND @ (forward + backward - 2.0 * self._gaps(X_EA)) / self.step**2)


# Pairs defined by a function of N and n_γ, which is compiled and called inside the law.


@register_pair()
class CompiledPair(PackagedPair):
    """Pair defined by a function that numba compiles; the compiled tick calls it by its address.

    ``function(X_WO, V_O, X_WE, V_E, parameters, N, n_gamma, gaps, points)`` reads the poses X_WO
    and X_WE (4, 4) of object and environment body, their twists V_O and V_E (6,), both at O in
    world axes, and the pair's parameters. It fills N (6, r), which is NaN before, n_γ (r,), the
    gaps (r,) and, for pairs that push, the point of application of each magnitude, points (3, r),
    world (m); these three are zero before. For their definitions see `ContactPair`. numba must be
    able to compile the function without Python objects. For real time it must not allocate, and to
    pickle the pair it must be defined in a module.

    Attributes:
        function: the function, plain or made by `numba.njit`, compiled once for all parameters.
        parameters: numbers of the geometry, in the units of the function.
        forces: r, 1 … 6.
        pushes: True if every magnitude is a force that must not become negative; then the function
            fills `points`, and friction is possible.
        name: name in messages and recordings.

    Example:
        >>> def level(*arrays: np.ndarray) -> None:  # the object's origin at a height
        ...     X_WO, V_O, X_WE, V_E, parameters, N, n_gamma, gaps, points = arrays
        ...     N[:, 0] = np.array([0.0, 0.0, -1.0, 0.0, 0.0, 0.0])
        ...     gaps[0] = X_WO[2, 3] - parameters[0]
        >>> print(osc.CompiledPair(level, parameters=[0.2]).gaps(pin.SE3.Identity()))
        [-0.2]
    """

    function: Callable[..., None]
    parameters: npt.ArrayLike = ()
    forces: int = 1
    pushes: bool = False
    name: str = "compiled_pair"
    _rows: Array = field(init=False, repr=False)  # parameters, 16 a row

    def _make(self) -> None:
        """Check the number of forces, and store the parameters in rows of 16 for the law."""
        if self.forces not in range(1, 7):
            raise InvalidInputError(f"{self.name}.forces = {self.forces}; give r, 1 … 6")
        numbers = as_array(f"{self.name}.parameters", self.parameters, (None,))
        rows = np.zeros((max(self.forces, -(-len(numbers) // 16)), 16))
        rows.flat[: len(numbers)] = numbers
        store(self, parameters=numbers, _rows=rows)
        self.row()

    def row(self) -> PairRow:
        """Row of the pair for the compiled law.

        Raises:
            InvalidInputError: numba cannot compile the function.
        """
        try:
            address = _compile_entry(self.function, self.forces, np.size(self.parameters))[0]
        except Exception as error:  # numba raises errors of many kinds: of syntax, names, types
            raise InvalidInputError(f"{self.name}: numba cannot compile it: {error}") from error
        return PairRow(FUNCTION, tuple(self._rows), len(self._rows) - self.forces, address)

    def _contact(self, b: Bodies) -> Contact:
        results = self._evaluated_columns(b)
        if not np.isfinite(results[:, :7]).all():
            raise ContactError(f"{self.name}: N or n_γ is not finite")
        return Contact(results[:, :6].T, results[:, 6], name=self.name)

    def _gaps(self, X_EA: SE3) -> Array:
        return self._evaluated_columns(Bodies.at_O(X_EA))[:, 7]

    def points_of_contact(self, X_WO: SE3, X_WE: SE3 | None = None) -> Array:
        """Points of application (3, r) of the magnitudes of a pair that pushes, world (m)."""
        return (
            X_WO.translation[:, None]
            + self._evaluated_columns(Bodies.at_O(X_WO, X_WE=X_WE))[:, 8:].T
        )

    def _evaluated_columns(self, b: Bodies) -> Array:
        """Column of N (6), n_γ, gap and point from O (3) of each magnitude, (r, 11).

        Args:
            b: poses and twists of object and environment at one instant.
        """
        results = np.empty((self.forces, 11))
        arguments = (b.X_A.homogeneous, b.V_A, b.X_E.homogeneous, b.V_E)
        rows = [np.ascontiguousarray(argument, dtype=float) for argument in arguments]
        call_address(self.row().address, *rows, self._rows, results)
        return results


@cache
def _compile_entry(function: Callable[..., None], forces: int, count: int) -> tuple[int, object]:
    """Make a C function of a pair's function; return its address and the object that keeps it.

    The law calls the C function by its address, with the addresses of arrays (see `evaluate`). The
    object must be kept, because the C function exists only as long as it does.

    Args:
        function: function of the pair, plain or compiled by numba.
        forces: number r of its contact forces.
        count: number of its parameters.

    Raises:
        InvalidInputError: numba is not installed.
    """
    try:
        import numba
    except ImportError as error:
        raise InvalidInputError(missing(error)) from error

    carray: Any = numba.carray  # type: ignore[attr-defined]
    source = getattr(function, "py_func", function)
    part = source if PLAIN_PYTHON else numba.njit(error_model="numpy")(source)

    def evaluate(X_WO: Any, V_O: Any, X_WE: Any, V_E: Any, parameters: Any, evaluated: Any) -> None:
        """Evaluate the pair for the law, which passes addresses of arrays.

        Args:
            X_WO, X_WE: (4, 4) poses of object and body.
            V_O, V_E: (6,) twists at O.
            parameters: (count,) parameters of the pair.
            evaluated: (forces, 11), filled: each row has a column of N (6), n_γ, the gap, and the
                point of contact from O (3); N is NaN where the function does not fill it.
        """
        pose = carray(X_WO, (4, 4))
        body = carray(X_WE, (4, 4))
        parameter_array = carray(parameters, (count,))
        out = carray(evaluated, (forces, 11))
        out[:, :6] = np.nan  # remains where the function does not fill N
        out[:, 6:] = 0.0
        N = out[:, :6].T
        points = out[:, 8:].T
        V_A = carray(V_O, (6,))
        part(pose, V_A, body, carray(V_E, (6,)), parameter_array, N, out[:, 6], out[:, 7], points)
        for i in range(forces):  # points of contact in the world, from the origin O
            for k in range(3):
                out[i, 8 + k] -= pose[k, 3]

    if PLAIN_PYTHON:
        callback: Any = ctypes.CFUNCTYPE(None, *[ctypes.POINTER(ctypes.c_double)] * 6)(evaluate)
        return (int(ctypes.cast(callback, ctypes.c_void_p).value or 0), callback)
    types: Any = numba.types
    callback = numba.cfunc(types.void(*[types.CPointer(types.float64)] * 6))(evaluate)
    return (int(callback.address), callback)
