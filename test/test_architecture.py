# SPDX-License-Identifier: Apache-2.0
"""Imports point downward, between the packages and within them; type-only imports count too."""

from __future__ import annotations

import ast
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ('gsdf_registration', 'msg_adapters', 'benchmarks')
# Each package may import those on the floors before its own
FLOORS = (
    {'common'},
    {'mesh', 'tracking', 'simulation', 'msg_adapters'},
    {'field', 'clients'},
    {'solver'},
    {'search'},
    {'registration'},
    {'live', 'session', 'visualization'},
    {'node', 'cli', 'benchmarks'},
)
MOST_PACKAGES, MOST_FLOORS = 14, 8


def modules() -> dict[str, Path]:
    """Return the file of every module by its dotted name."""
    found = {}
    for package in PACKAGES:
        for file in (ROOT / package).rglob('*.py'):
            parts = file.relative_to(ROOT).with_suffix('').parts
            found['.'.join(parts[:-1] if parts[-1] == '__init__' else parts)] = file
    return found


def imports_of(file: Path, known: set[str]) -> set[str]:
    """Return the modules of ours that a file imports anywhere, for types included."""
    found = set()
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names = {f'{node.module}.{alias.name}' for alias in node.names}
            found |= (names & known) or {node.module}
    return found & known


def package_of(module: str) -> str:
    """Return the package that a module belongs to; the front of gsdf_registration has none."""
    first, *rest = module.split('.')
    return first if first != 'gsdf_registration' else (rest or [''])[0]


MODULES = modules()
IMPORTS = {name: imports_of(file, set(MODULES)) for name, file in MODULES.items()}
FLOOR = {package: number for number, packages in enumerate(FLOORS) for package in packages}


def test_number_of_packages_and_floors_is_limited() -> None:
    packages = {package_of(name) for name in MODULES if name.startswith('gsdf_registration.')}
    loose = {name for name in packages if f'gsdf_registration.{name}' in MODULES
             and MODULES[f'gsdf_registration.{name}'].name != '__init__.py'}
    assert len(packages - loose) <= MOST_PACKAGES
    assert loose <= {'__main__'}
    assert len(FLOORS) <= MOST_FLOORS


@pytest.mark.parametrize('package', sorted(FLOOR))
def test_a_package_imports_only_from_floors_below(package: str) -> None:
    upward = {(name, other) for name, others in IMPORTS.items() if package_of(name) == package
              for other in others if package_of(other) not in ('', '__main__', package)
              and FLOOR[package_of(other)] >= FLOOR[package]}
    assert upward == set()


def test_adapters_import_only_common() -> None:
    others = {other for name, others in IMPORTS.items() if package_of(name) == 'msg_adapters'
              for other in others}
    assert {package_of(name) for name in others} <= {'', 'common', 'msg_adapters'}


def test_no_module_imports_itself_through_others() -> None:
    # a package's __init__ re-exports its modules; they import each other directly
    graph = {name: others - {name.rpartition('.')[0]} for name, others in IMPORTS.items()}
    try:
        tuple(TopologicalSorter(graph).static_order())
    except CycleError as error:
        pytest.fail(' -> '.join(error.args[1]))
