# SPDX-License-Identifier: Apache-2.0
"""Run a node or a player as a process, and show its output if something fails."""

from __future__ import annotations

import os
import subprocess
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import IO

from gsdf_registration.common.result import InputError


@contextmanager
def running(command: Sequence[str], name: str, environment: Mapping[str, str] = {}
            ) -> Iterator[subprocess.Popen[bytes]]:
    """
    Run a process during the block; append its last output to an `InputError` of the block.

    ``environment`` is added to that of this process.
    """
    with tempfile.TemporaryFile() as log:
        process = subprocess.Popen(command, stdout=log, stderr=log,
                                   env={**os.environ, **environment})
        try:
            yield process
        except InputError as error:
            raise InputError(f'{error.message}; {name} printed: {_tail(log)}') from None
        finally:
            process.terminate()
            process.wait()


def _tail(log: IO[bytes]) -> str:
    log.seek(0)
    return ' | '.join(log.read().decode(errors='replace').split('\n')[-5:]).strip(' |') or 'nothing'
