# SPDX-License-Identifier: Apache-2.0
"""The median of an array by selection in place (Hoare 1961), without taking memory."""

from __future__ import annotations

from gsdf_registration.common.numba_options import kernel


@kernel
def median(x):
    """Return the median of ``x`` (n,), n >= 1, none of them NaN; their order is lost."""
    half = len(x) // 2
    upper = _select(x, half)
    if len(x) % 2 == 1:
        return upper
    lower = x[0]        # the greatest of the lower half, which selection has put in front
    for i in range(1, half):
        lower = max(lower, x[i])
    return 0.5 * (lower + upper)


@kernel
def _select(x, rank):
    """Return the value that has ``rank`` others before it; those put before it are no greater."""
    low, high = 0, len(x) - 1
    while low < high:
        # the middle one of three: values that are sorted already must not take forever
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
