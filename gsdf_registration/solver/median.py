# SPDX-License-Identifier: Apache-2.0
"""Median of an array by in-place selection (Hoare 1961), without allocating memory."""

from __future__ import annotations

from gsdf_registration.common.numba_options import kernel


@kernel
def median(x):
    """Return the median of ``x`` (n,), n >= 1, without NaN; ``x`` is reordered."""
    half = len(x) // 2
    upper = _select(x, half)
    if len(x) % 2 == 1:
        return upper
    lower = x[0]        # the maximum of the lower half, which the selection has moved to the front
    for i in range(1, half):
        lower = max(lower, x[i])
    return 0.5 * (lower + upper)


@kernel
def _select(x, rank):
    """Return the value of the given rank, moved to that position; no value before it is larger."""
    low, high = 0, len(x) - 1
    while low < high:
        # median of three: sorted values must not lead to quadratic time
        a, b, c = x[low], x[(low + high) // 2], x[high]
        pivot = max(min(a, b), min(max(a, b), c))
        i, j = low, high
        while i <= j:
            while x[i] < pivot:
                i += 1
            while x[j] > pivot:
                j -= 1
            if i <= j:
                x[i], x[j] = x[j], x[i]
                i += 1
                j -= 1
        if rank <= j:
            high = j
        elif rank >= i:
            low = i
        else:
            break
    return x[rank]
