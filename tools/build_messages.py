# SPDX-License-Identifier: Apache-2.0
"""
Build the message packages that have no wheel into the virtual environment of this Python.

These are gsdf_registration_msgs and tf2_msgs.  The ROS wheels carry the generators (extra
``messages``); a C++ compiler and the headers of Python must be there.  A package that can be
imported and is up to date is not built again.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import sysconfig
import tempfile
from pathlib import Path

PREFIX = Path(sys.prefix)
TOOLS = Path(__file__).parent
PACKAGES = (TOOLS / 'tf2_msgs', TOOLS.parent / 'gsdf_registration_msgs')


def is_built(package: Path) -> bool:
    """Return whether a new process can send messages of the package as its sources define them."""
    installed = PREFIX / 'share' / package.name
    sources = [*package.glob('msg/*.msg'), *package.glob('srv/*.srv')]
    # a package that is not in this prefix comes from a ROS install and is used as it is there
    if installed.exists() and not all(
            _same(source, installed / source.relative_to(package)) for source in sources):
        return False
    check = (f'from {package.name}.msg import {sources[0].stem} as M; '
             'type(M).__import_type_support__(); assert type(M)._TYPE_SUPPORT is not None')
    return subprocess.run([sys.executable, '-c', check], cwd=PREFIX,
                          capture_output=True).returncode == 0


def _same(a: Path, b: Path) -> bool:
    return b.is_file() and a.read_bytes() == b.read_bytes()


def patch_cmake_files() -> None:
    """Replace the include paths of the build machine in the CMake files of the wheels."""
    import numpy

    ours = {re.compile(r'/opt/python/[^;"\s]*/numpy/(_core|core)/include'): numpy.get_include(),
            re.compile(r'/opt/python/[^;"\s]*/include/python3\.\d+'): sysconfig.get_path('include')}
    for file in PREFIX.glob('share/*/cmake/*.cmake'):
        text = patched = file.read_text()
        for theirs, path in ours.items():
            patched = theirs.sub(path, patched)
        if patched != text:
            file.write_text(patched)


def build(package: Path) -> None:
    """Configure, compile and install; raise CalledProcessError with the log as its output."""
    environment = {**os.environ, 'PATH': f'{PREFIX}/bin:{os.environ["PATH"]}',
                   'AMENT_PREFIX_PATH': str(PREFIX)}
    with tempfile.TemporaryDirectory() as folder:
        configure = ['cmake', '-S', str(package), '-B', folder, '-G', 'Ninja',
                     '-DBUILD_TESTING=OFF', f'-DCMAKE_INSTALL_PREFIX={PREFIX}',
                     f'-DCMAKE_PREFIX_PATH={PREFIX}', f'-DPython3_EXECUTABLE={sys.executable}']
        for command in (configure, ['cmake', '--build', folder, '--target', 'install']):
            subprocess.run(command, env=environment, text=True, check=True,
                           stdout=subprocess.PIPE, stderr=subprocess.STDOUT)


def main() -> int:
    """Build what is missing; return 0 if all packages can be used, or need not be."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--optional', action='store_true',
                        help='go on with one sentence if a package cannot be built')
    optional = parser.parse_args().optional
    for package in PACKAGES:
        if is_built(package):
            continue
        print(f'building {package.name}, once', flush=True)
        try:
            patch_cmake_files()
            build(package)
            failure = '' if is_built(package) else 'it was installed but cannot be imported'
        except subprocess.CalledProcessError as error:
            failure = error.output
        if failure and optional:
            print(f'{package.name} cannot be built, so the node runs without it; for the reason '
                  f'run: {sys.executable} {__file__}')
        elif failure:
            print(f'{package.name} cannot be built:\n{failure}', file=sys.stderr)
            return 1
    return 0


if __name__ == '__main__':
    sys.exit(main())
