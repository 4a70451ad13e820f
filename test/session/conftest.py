# SPDX-License-Identifier: Apache-2.0
"""The bone that the tests of a session share."""

from __future__ import annotations

import pytest
from session_fixtures import bone

from gsdf_registration.field import Field


@pytest.fixture(scope='session')
def field() -> Field:
    return bone()
