# SPDX-License-Identifier: Apache-2.0
"""
Virtual environments for the peers, created once and stored in the cache.

Unmaintained libraries need an old Python and pinned versions; the environments keep them apart.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from gsdf_registration.field.cache import cache_directory

INSTALL_LIMIT = 1800.0      # s, for one library
OWN = '.'.join(map(str, sys.version_info[:2]))


@dataclass(frozen=True)
class Group:
    """
    Libraries that share an environment.

    pythons : suitable versions, the best first
    base : requirements installed first; all are needed
    libraries : name -> requirements of that library; a failure does not affect the others
    """

    name: str
    pythons: tuple[str, ...]
    base: tuple[str, ...]
    libraries: dict[str, tuple[str, ...]]


@dataclass(frozen=True)
class Environment:
    """A Python (None: not created), and the reason for each library that is missing."""

    python: Path | None
    missing: dict[str, str]


def environment(group: Group) -> Environment:
    """
    Return the environment of a group; missing libraries are installed, which takes minutes.

    A library that could not be installed is tried again the next time.
    """
    interpreter = next(_pythons(group.pythons), None)
    if interpreter is None:
        reason = f'needs Python {" or ".join(group.pythons)} with venv, which was not found'
        return Environment(None, dict.fromkeys(group.libraries, reason))
    recipe = json.dumps([str(interpreter), group.base])
    digest = hashlib.sha256(recipe.encode()).hexdigest()[:12]
    folder = cache_directory() / 'peers' / f'{group.name}-{digest}'
    python = folder / 'bin' / 'python'
    try:
        if not (folder / 'complete').exists():
            shutil.rmtree(folder, ignore_errors=True)
            _run([interpreter, '-m', 'venv', folder])
            _install(python, group.base)
            (folder / 'complete').touch()
    except RuntimeError as error:
        return Environment(None, dict.fromkeys(group.libraries, str(error)))
    missing = {}
    for library, requirements in group.libraries.items():
        mark, recipe = folder / f'complete-{library}', json.dumps(requirements)
        if not mark.exists() or mark.read_text() != recipe:
            try:
                _install(python, requirements)
                mark.write_text(recipe)
            except RuntimeError as error:
                missing[library] = str(error)
    return Environment(python, missing)


def clean_environment() -> dict[str, str]:
    """Return the environment variables without those that point to our own packages."""
    return {name: value for name, value in os.environ.items()
            if name not in ('PYTHONPATH', 'PYTHONHOME', 'VIRTUAL_ENV', 'LD_LIBRARY_PATH')}


def _install(python: Path, requirements: tuple[str, ...]) -> None:
    # build with the packages of `base`: some sources do not declare what they need
    _run([python, '-m', 'pip', 'install', '--quiet', '--disable-pip-version-check',
          '--no-build-isolation', *requirements])


def _run(command: list[Path | str]) -> None:
    """Run a command; raise RuntimeError with the error line of its output if it fails."""
    try:
        done = subprocess.run(command, env=clean_environment(), stdin=subprocess.DEVNULL,
                              capture_output=True, text=True, timeout=INSTALL_LIMIT)
    except (OSError, subprocess.TimeoutExpired) as error:
        raise RuntimeError(f'not installed: {error}') from None
    if done.returncode:
        lines = [line.strip() for line in (done.stdout + done.stderr).splitlines()]
        errors = [line for line in lines if 'error' in line.lower()] or lines or ['no output']
        raise RuntimeError(f'not installed: {errors[0][:200]}')


def _pythons(versions: tuple[str, ...]) -> Iterator[Path]:
    """Yield interpreters of these versions that can create an environment."""
    probe = 'import ensurepip, venv, sys; print(*sys.version_info[:2], sep=".")'
    for version in versions:
        own = [Path(sys.executable)] if version == OWN else []
        on_path = [Path(found) for found in [shutil.which(f'python{version}')] if found]
        pyenv = Path(os.environ.get('PYENV_ROOT') or Path.home() / '.pyenv') / 'versions'
        for python in (*on_path, *sorted(pyenv.glob(f'{version}.*/bin/python')), *own):
            try:
                probed = subprocess.run([python, '-c', probe], env=clean_environment(),
                                      capture_output=True, text=True, timeout=30.0)
            except (OSError, subprocess.TimeoutExpired):
                continue
            if probed.stdout.strip() == version:
                yield python
