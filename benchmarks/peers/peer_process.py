# SPDX-License-Identifier: Apache-2.0
"""The process of a peer: send it points, receive its pose, stop it after a time limit."""

from __future__ import annotations

import json
import os
import select
import subprocess
from collections.abc import Sequence
from pathlib import Path
from time import monotonic
from typing import Any

import numpy as np

from benchmarks.peers.environment import clean_environment
from gsdf_registration.common.rigid import Array

LIMIT = 60.0            # s, per answer
PREPARATION = 600.0     # s, to import a library and to prepare a bone; not measured
WORKERS = Path(__file__).parent / 'workers'


class PeerError(Exception):
    """There is no answer; ``timeout``: because the time limit was reached."""

    def __init__(self, message: str, timeout: bool = False) -> None:
        super().__init__(message)
        self.timeout = timeout


class PeerProcess:
    """
    A peer with a prepared bone.

    Parameters
    ----------
    python : of the environment of the peer
    worker : module and function among the workers
    model : file with vertices, faces, points and normals of the bone, m

    Raises
    ------
    PeerError
        If it cannot be started.

    """

    def __init__(self, python: Path, worker: tuple[str, str], model: Path,
                 limit: float = LIMIT) -> None:
        self.limit = limit
        self.stated = np.zeros(0)       # accuracy of the last answer, if the peer states one
        self._rest = b''
        self._process = subprocess.Popen(
            [python, WORKERS / 'worker.py', *worker, model], env=clean_environment(),
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
        self._answer(PREPARATION)

    def __call__(self, points: Array, noise: float) -> tuple[Array, float]:
        """
        Return the transform (4, 4), m, from the points to the bone, and the time, s.

        Parameters
        ----------
        points : (n, 3) float, m, bone frame, transformed by the start
        noise : float, m, standard deviation per axis

        Raises
        ------
        PeerError
            If it fails, or exceeds the time limit, after which it is stopped.

        """
        assert self._process.stdin is not None
        question = json.dumps({'points': points.tolist(), 'noise': noise})
        try:
            self._process.stdin.write(question.encode() + b'\n')
            self._process.stdin.flush()
        except BrokenPipeError:
            raise PeerError(self._exit_status()) from None
        answer = self._answer(self.limit)
        motion, self.stated = np.array(answer['motion']), np.array(answer['stated'])
        if motion.shape != (4, 4) or not np.isfinite(motion).all():
            raise PeerError('no finite pose')
        return motion, float(answer['seconds'])

    @property
    def alive(self) -> bool:
        """Whether it can answer again."""
        return self._process.poll() is None

    def close(self) -> None:
        """Kill the process."""
        self._process.kill()
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                pipe.close()

    def _answer(self, limit: float) -> dict[str, Any]:
        try:
            line = self._line(monotonic() + limit)
        except TimeoutError:
            self.close()
            raise PeerError(f'no answer within {limit:.0f} s', timeout=True) from None
        if line is None:
            raise PeerError(self._exit_status())
        answer: dict[str, Any] = json.loads(line)
        if 'error' in answer:
            raise PeerError(answer['error'])
        return answer

    def _line(self, deadline: float) -> bytes | None:
        """Return the next line, None at the end of the process."""
        assert self._process.stdout is not None
        while b'\n' not in self._rest:
            left: Sequence[Any] = select.select([self._process.stdout], [], [],
                                                max(deadline - monotonic(), 0.0))[0]
            if not left:
                raise TimeoutError
            piece = os.read(self._process.stdout.fileno(), 65536)
            if not piece:
                return None
            self._rest += piece
        line, _, self._rest = self._rest.partition(b'\n')
        return line

    def _exit_status(self) -> str:
        """Return as text how the process exited."""
        status = self._process.wait()
        self.close()
        return f'died of signal {-status}' if status < 0 else f'exited with status {status}'
