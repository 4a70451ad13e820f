# SPDX-License-Identifier: Apache-2.0
"""Connected components of a graph."""

from __future__ import annotations

import numpy as np

from gsdf_registration.common.components import components


def test_labels_nodes_that_are_connected() -> None:
    count, label = components(np.array([[0, 1], [3, 1], [4, 5]]), 7)
    assert count == 4 and label.dtype == np.int64
    assert label[0] == label[1] == label[3] and label[4] == label[5]
    assert len({label[0], label[2], label[4], label[6]}) == 4


def test_nodes_without_edges_are_alone() -> None:
    count, label = components(np.zeros((0, 2), np.int64), 3)
    assert count == 3 and sorted(label) == [0, 1, 2]
