# SPDX-License-Identifier: Apache-2.0
"""
Collects test modules like the pytest plugin of launch_testing; for ``pytest -p``.

A ROS install loads that plugin into every pytest. It has no wheel and needs pytest 7, so this is a
stand-in with the same hook. The hook imports each module before the collector of the module
exists, and catches a SyntaxError only. A module that skips itself while it is imported therefore
ends the collection of its folder, and pytest reports success.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from _pytest.pathlib import import_path

OPTIONS = {'consider_namespace_packages': False} if pytest.version_tuple >= (8, 1) else {}


def pytest_pycollect_makemodule(module_path: Path, parent: pytest.Collector) -> pytest.Module:
    """Import the module, and return its collector; there are no launch tests."""
    try:
        module = import_path(module_path, root=parent.config.rootpath, **OPTIONS)
        assert not hasattr(module, 'generate_test_description')
    except SyntaxError:
        pass
    return pytest.Module.from_parent(parent, path=module_path)
