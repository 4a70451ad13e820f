# SPDX-License-Identifier: Apache-2.0
"""
Matrices of Gaussian processes: Matern covariance, Cholesky and tridiagonal forms.

Not from a library: the last bits would depend on its threads.
"""

from __future__ import annotations

import math

import numpy as np

from gsdf_registration.common.numba_options import kernel


@kernel
def add_matern(distance, root, length, variance, S):
    """Add the Matern 3/2 covariance of cells to S (m, m), scaled by the roots of the weights."""
    for i in range(len(S)):
        for j in range(i + 1):
            d = math.sqrt(3.0) * distance[i, j] / length
            value = variance * (1.0 + d) * math.exp(-d) * root[i] * root[j]
            S[i, j] += value
            if i != j:
                S[j, i] += value


@kernel
def tridiagonalize(S, rows, diagonal, beside):
    """
    Transform S to Q^T S Q, tridiagonal, and each row r to r Q (Householder; Golub, Van Loan 8.3.1).

    S, rows : (m, m) and (k, m), overwritten
    diagonal, beside : (m,), filled; ``beside[i]`` is between i and i + 1
    """
    m = len(S)
    v, p = np.zeros(m), np.zeros(m)
    # from the last row up: loops that start at zero vectorize
    for k in range(m - 1, 0, -1):
        diagonal[k] = S[k, k]
        squared = 0.0
        for i in range(k):
            v[i] = S[k, i]
            squared += v[i] * v[i]
        length = math.sqrt(squared)
        beside[k - 1] = -length if v[k - 1] > 0.0 else length
        norm = 2.0 * (squared - beside[k - 1] * v[k - 1])
        v[k - 1] -= beside[k - 1]
        if norm <= 0.0:
            continue
        beta = 2.0 / norm
        # p = beta S v - (beta^2 v^T S v / 2) v; as S is symmetric, its rows are summed, which is
        # faster than products of rows
        for i in range(k):
            p[i] = 0.0
        for j in range(k):
            factor = beta * v[j]
            for i in range(k):
                p[i] += factor * S[j, i]
        inner = 0.0
        for i in range(k):
            inner += p[i] * v[i]
        for i in range(k):
            p[i] -= 0.5 * beta * inner * v[i]
        for i in range(k):
            v_i, p_i = v[i], p[i]
            for j in range(k):
                S[i, j] -= v_i * p[j] + p_i * v[j]
        for row in rows:
            total = 0.0
            for i in range(k):
                total += row[i] * v[i]
            for i in range(k):
                row[i] -= beta * total * v[i]
    diagonal[0] = S[0, 0]


@kernel
def gram(diagonal, beside, square, rows, G):
    """
    Fill ``G`` (k, k) with r_i V^-1 r_j, V = I + square T, T tridiagonal; return log det V.

    rows : (k, m), overwritten
    """
    G[:] = 0.0
    log_det, pivot = 0.0, 1.0
    for k in range(len(diagonal)):
        factor = square * beside[k - 1] / pivot if k > 0 else 0.0
        pivot = 1.0 + square * diagonal[k] - (factor * square * beside[k - 1] if k > 0 else 0.0)
        log_det += math.log(pivot)
        for i in range(len(rows)):
            if k > 0:
                rows[i, k] -= factor * rows[i, k - 1]
            for j in range(i + 1):
                G[i, j] += rows[i, k] * rows[j, k] / pivot
    for i in range(len(rows)):
        for j in range(i):
            G[j, i] = G[i, j]
    return log_det


@kernel
def solve(U, rows):
    """Replace each row r of ``rows`` (k, m) by V^-1 r, V = U^T U."""
    forward_substitute(U, rows)
    for row in rows:
        for k in range(len(U) - 1, -1, -1):
            total = row[k]
            for j in range(k + 1, len(U)):
                total -= U[k, j] * row[j]
            row[k] = total / U[k, k]


@kernel
def factor(V):
    """Replace the upper triangle of ``V`` by U, V = U^T U (Cholesky); return log det V."""
    m = len(V)
    log_det = 0.0
    for k in range(m):
        pivot = math.sqrt(V[k, k])
        log_det += 2.0 * math.log(pivot)
        for i in range(k, m):
            V[k, i] /= pivot
        for j in range(k + 1, m):
            factor = V[k, j]
            for i in range(j, m):
                V[j, i] -= factor * V[k, i]
    return log_det


@kernel
def forward_substitute(U, rows):
    """Replace each row r of ``rows`` (k, m) by U^-T r."""
    for row in rows:
        for k in range(len(U)):
            row[k] /= U[k, k]
            for j in range(k + 1, len(U)):
                row[j] -= U[k, j] * row[k]
