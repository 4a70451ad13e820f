# SPDX-License-Identifier: Apache-2.0
"""Drop-outs of single tools, and gaps of the tracker."""

from __future__ import annotations

import numpy as np

from gsdf_registration.simulation.losses import Losses, received

RATE = 40.0
STAMPS = np.arange(8000) / RATE


def seen(losses: Losses) -> np.ndarray:
    return received(STAMPS, 2, RATE, losses, np.random.default_rng(0))


def test_nothing_is_lost_by_default() -> None:
    assert seen(Losses()).all()


def test_each_tool_drops_out_by_itself_in_short_bursts() -> None:
    masks = seen(Losses(dropouts=0.1))
    np.testing.assert_allclose(masks.mean(axis=1), 0.9)
    both = (~masks[0] & ~masks[1]).mean()
    assert 0.005 < both < 0.02      # 0.01 if they are independent
    assert np.diff(STAMPS[masks[0]]).max() < 0.5


def test_in_a_gap_of_125_ms_no_tool_is_reported() -> None:
    masks = seen(Losses(gaps=6.0))
    assert np.array_equal(*masks)
    steps = np.diff(STAMPS[masks[0]])
    long = steps[steps > 1.5 / RATE]
    assert 10 < len(long) < 35      # 20 are expected
    np.testing.assert_allclose(np.median(long), 0.125, atol=1e-9)
