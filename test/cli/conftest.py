# SPDX-License-Identifier: Apache-2.0
"""A fixture of all tests of this folder."""

from __future__ import annotations

import pytest


@pytest.fixture(autouse=True)
def one_ray_per_pixel(monkeypatch: pytest.MonkeyPatch) -> None:
    """Draw with one ray per pixel, which is faster and shows the same."""
    monkeypatch.setattr('gsdf_registration.visualization.picture.OVERSAMPLING', 1)
