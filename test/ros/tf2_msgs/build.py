# SPDX-License-Identifier: Apache-2.0
"""
Build tf2_msgs into the virtual environment of the Python that runs this.

The ROS wheels have no tf2_msgs, without which nothing goes out on /tf, but they carry the
generators (extra ``test``).  Where tf2_msgs is there already, there is nothing to do.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import sysconfig
import tempfile
from pathlib import Path

PREFIX = Path(sys.prefix)
CHECK = ('from tf2_msgs.msg import TFMessage as M; type(M).__import_type_support__(); '
         'assert type(M)._TYPE_SUPPORT is not None')


def is_built() -> bool:
    """Tell whether a new process can send a TFMessage."""
    return subprocess.run([sys.executable, '-c', CHECK], cwd=PREFIX,
                          capture_output=True).returncode == 0


def point_cmake_at_this_python() -> None:
    """Replace the include paths that the wheels' CMake files carry from where they were made."""
    import numpy

    ours = {re.compile(r'/opt/python/[^;"\s]*/numpy/(_core|core)/include'): numpy.get_include(),
            re.compile(r'/opt/python/[^;"\s]*/include/python3\.\d+'): sysconfig.get_path('include')}
    for file in PREFIX.glob('share/*/cmake/*.cmake'):
        text = patched = file.read_text()
        for theirs, path in ours.items():
            patched = theirs.sub(path, patched)
        if patched != text:
            file.write_text(patched)


def build() -> None:
    """Configure, compile and install; raises CalledProcessError with the log on standard output."""
    environment = {**os.environ, 'PATH': f'{PREFIX}/bin:{os.environ["PATH"]}',
                   'AMENT_PREFIX_PATH': str(PREFIX)}
    with tempfile.TemporaryDirectory() as folder:
        configure = ['cmake', '-S', str(Path(__file__).parent), '-B', folder, '-G', 'Ninja',
                     '-DBUILD_TESTING=OFF', f'-DCMAKE_INSTALL_PREFIX={PREFIX}',
                     f'-DCMAKE_PREFIX_PATH={PREFIX}', f'-DPython3_EXECUTABLE={sys.executable}']
        for command in (configure, ['cmake', '--build', folder, '--target', 'install']):
            done = subprocess.run(command, env=environment, text=True, stdout=subprocess.PIPE,
                                  stderr=subprocess.STDOUT)
            if done.returncode != 0:
                print(done.stdout)
                done.check_returncode()


def main() -> int:
    """Build unless it is there; return 0 when a TFMessage can be sent."""
    if not is_built():
        point_cmake_at_this_python()
        build()
        if not is_built():
            print(f'tf2_msgs was built into {PREFIX} but cannot be imported', file=sys.stderr)
            return 1
    return 0


if __name__ == '__main__':
    sys.exit(main())
