"""Sparse symmetric systems: solution, and the entries of the inverse that belong to the system's own pattern."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import SuperLU, splu

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


class Factor(NamedTuple):
    """L U of a system whose unknowns were put in another order: place k holds unknown `order[k]`."""

    lu: SuperLU
    order: Ints

    def solve(self, right: Floats) -> Floats:
        """(n,) or (n, k) solutions."""
        out = np.empty_like(right)
        out[self.order] = self.lu.solve(right[self.order])
        return out


def factor(matrix: sparse.csc_matrix, shared: int = 0, order: Ints | None = None) -> Factor:
    """L U of a symmetric positive definite matrix, pivots on the diagonal; RuntimeError when it is singular.

    order : of elimination, that of a matrix with nearly the same pattern; found anew when None
    shared : see `elimination_order`
    """
    if order is None:
        order = elimination_order(matrix, shared)
    turned = matrix[order][:, order].tocsc()
    lu = splu(turned, permc_spec="NATURAL", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    return Factor(lu, order)


def elimination_order(matrix: sparse.csc_matrix, shared: int = 0) -> Ints:
    """(n,) unknowns in an order of minimum degree.

    shared : how many unknowns at the end take part in very many equations. They are eliminated last, and the
    order of the others is found without them: with them it grows with the square.
    """
    own = matrix.shape[0] - shared
    pattern = matrix[:own, :own].tocsc(copy=True)
    pattern.data = np.full(len(pattern.data), -1.0)
    degree = np.diff(pattern.indptr)
    stencil = (pattern + sparse.diags(degree + 1.0)).tocsc()
    plan = splu(stencil, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    return np.concatenate([np.argsort(plan.perm_c), np.arange(own, own + shared)]).astype(np.int64)


def inverse_on_pattern(found: Factor) -> sparse.csc_matrix:
    """The inverse, exact, at all entries where the factor is not zero (Takahashi, Fagan and Chin 1973).

    This is all a sparse adjustment needs: covariances of neighbours and redundancies of observations.
    """
    lower = found.lu.L.tocsc()
    lower.sort_indices()
    values = _takahashi(lower.indptr, lower.indices, lower.data, found.lu.U.diagonal())
    half = sparse.csc_matrix((values, lower.indices, lower.indptr), shape=lower.shape)
    full = half + sparse.tril(half, -1).T
    place = np.empty(len(found.order), np.int64)
    place[found.order] = found.lu.perm_c
    out: sparse.csc_matrix = full[place][:, place].tocsc()
    return out


@njit(cache=True, nogil=True)
def _takahashi(indptr, indices, data, pivot):  # type: ignore[no-untyped-def]  # pragma: no cover
    n = len(indptr) - 1
    z = np.zeros(len(data))
    place = np.full(n, -1, np.int64)
    for j in range(n - 1, -1, -1):
        start, stop = indptr[j] + 1, indptr[j + 1]
        for a in range(start, stop):
            place[indices[a]] = a
        # Z[i, j] = -sum_k Z[i, k] L[k, j], over the rows i, k > j of column j
        for b in range(start, stop):
            k, factor_kj = indices[b], data[b]
            z[b] -= z[indptr[k]] * factor_kj
            for c in range(indptr[k] + 1, indptr[k + 1]):
                a = place[indices[c]]
                if a >= 0:
                    z[a] -= z[c] * factor_kj
                    z[b] -= z[c] * data[a]
        total = 1.0 / pivot[j]
        for a in range(start, stop):
            total -= z[a] * data[a]
            place[indices[a]] = -1
        z[indptr[j]] = total
    return z
