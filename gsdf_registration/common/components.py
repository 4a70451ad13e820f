# SPDX-License-Identifier: Apache-2.0
"""Connected components of a graph."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components


def components(pairs: NDArray[np.int64], n: int) -> tuple[int, NDArray[np.int64]]:
    """
    Return the number and labels (n,) of the connected components of n nodes.

    Parameters
    ----------
    pairs : (m, 2) int
        Nodes that are connected.
    n : int

    """
    graph = coo_array((np.ones(len(pairs), dtype=np.bool_), (pairs[:, 0], pairs[:, 1])),
                      shape=(n, n))
    count, label = connected_components(graph, directed=False)
    return int(count), np.asarray(label, dtype=np.int64)
