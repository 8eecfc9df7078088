"""Nonnegative least squares for several cones of wrenches at once."""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray

from osc_contact.spatial import Array

RIDGE = 1e-9  #: added to Gram matrices of unit diagonal, so that dependent columns have a solution


class Cones:
    """Cones {Nα : α ≥ 0} of several candidates, each with some of the columns of one N.

    The least squares of a candidate are solved for each subset of its columns; the best solution
    without a negative magnitude is that of the constrained problem.

    Args:
        columns: numbers of the columns of N of each candidate.
        pushes: (r,) whether a magnitude must not become negative, for each column of N.

    Attributes:
        index: (n, k) numbers of the columns of each candidate, 0 where it has fewer than k.
        used: (n, k) 1 where it has a column, else 0.
    """

    def __init__(self, columns: list[list[int]], pushes: NDArray[np.bool_]) -> None:
        """Enumerate the subsets of the columns of each candidate.

        Args:
            columns: indices of the columns of N of each candidate.
            pushes: (all columns,) True for a column with a force of one sign, which may be zero. A
                column with a force of either sign is in every subset.
        """
        # index (candidates, most) of the columns; `used` is 0 where a candidate has fewer columns
        most = max((len(indices) for indices in columns), default=0)
        self.index = np.zeros((len(columns), most), dtype=np.intp)
        self.used = np.zeros((len(columns), most))
        owners: list[int] = []
        masks: list[tuple[float, ...]] = []
        for i, indices in enumerate(columns):
            self.index[i, : len(indices)] = indices
            self.used[i, : len(indices)] = 1.0
            choices = [(0.0, 1.0) if pushes[column] else (1.0,) for column in indices]
            padding = [(0.0,)] * (most - len(indices))
            for mask in product(*choices, *padding):
                owners.append(i)
                masks.append(mask)
        #: (n, k) whether a magnitude must not be negative
        self._pushes = (self.used > 0.0) & pushes[self.index] if most else self.used > 0.0
        self._owners = np.array(owners, dtype=np.intp)  #: (m,) candidate of each subset of columns
        self._masks = np.array(masks).reshape(len(owners), most)
        #: (n,) first subset of each candidate
        self._first = np.searchsorted(self._owners, np.arange(len(columns)))

    def gram(self, N: Array, S: Array) -> tuple[Array, Array]:
        """Gram matrices G = NᵀS⁻¹N (n, k, k), and S⁻¹N (n, 6, k); zero for columns not used.

        Args:
            N: (6, r) columns of all candidates.
            S: (6, 6) covariance of the wrench, or (n, 6, 6), one for each candidate.
        """
        lines = np.moveaxis(N[:, self.index], 0, 1) * self.used[:, None]
        weighted = np.linalg.solve(np.broadcast_to(S, (len(lines), 6, 6)), lines)
        return lines.transpose(0, 2, 1) @ weighted, weighted

    def fit(self, N: Array, S: Array, wrench: Array) -> tuple[Array, Array, Array]:
        """Fit a wrench f: the least (f − Nα)ᵀS⁻¹(f − Nα) of each candidate with α ≥ 0.

        The normal equations G α = NᵀS⁻¹f are solved for each subset of a candidate's columns
        (`_masks`); columns outside the subset get α = 0. Of the subsets without a negative
        magnitude that must not be negative, the one that explains most of f is the solution.

        Args:
            N: (6, r) columns of all candidates (N, N m per unit of α).
            S: (6, 6) covariance of the wrench, or (n, 6, 6), one for each candidate.
            wrench: (6,) wrench f (N, N m), or (n, 6), one for each candidate.

        Returns:
            Magnitudes α (n, k), the least squares (n,), and the Gram matrices (n, k, k).
        """
        G, weighted = self.gram(N, S)
        f = np.broadcast_to(wrench, (len(G), 6))
        whole = np.linalg.solve(np.broadcast_to(S, (len(G), 6, 6)), f[:, :, None])[:, :, 0]
        length = np.einsum("na,na->n", whole, f)
        most = self.index.shape[1]
        if most == 0:
            return np.zeros((len(G), 0)), length, G
        # normal equations, scaled to a unit diagonal; places without a column have the size 1
        sizes = np.sqrt(np.einsum("nkk->nk", G)) + (1.0 - self.used)
        right = np.einsum("nak,na->nk", weighted, f) / sizes
        scaled = G / (sizes[:, :, None] * sizes[:, None]) + RIDGE * np.eye(most)
        # the same for each subset: rows and columns outside it are those of the identity
        mask = self._masks
        system = scaled[self._owners] * mask[:, :, None] * mask[:, None]
        system += np.einsum("mk,kl->mkl", 1.0 - mask, np.eye(most))
        target = right[self._owners] * mask
        alpha = np.linalg.solve(system, target[:, :, None])[:, :, 0]
        # fᵀS⁻¹f less the least squares of each subset; the largest of a candidate is chosen
        explained = np.einsum("mk,mk->m", target, alpha)
        negative = ((alpha < 0.0) & self._pushes[self._owners]).any(axis=1)
        explained[negative] = -np.inf
        best = np.lexsort((-explained, self._owners))[self._first]
        squares = np.maximum(length - explained[best], 0.0)
        return alpha[best] / sizes, squares, G
