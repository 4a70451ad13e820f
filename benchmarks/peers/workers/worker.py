# SPDX-License-Identifier: Apache-2.0
"""
One peer and one bone: says that it is ready, then answers each line of JSON with another.

Run as ``python worker.py MODULE PEER MODEL.npz``.  A question holds ``points`` (n, 3), m, bone
frame, placed by the start, and ``noise``, m; the answer ``motion`` (4, 4) of the points and the
``seconds`` it took, or ``error``.
"""

from __future__ import annotations

import ctypes
import importlib
import json
import os
import sys
from time import perf_counter
from typing import Any

import numpy as np


def main(module: str, peer: str, model: str) -> None:
    """Prepare the peer, then answer until there are no more questions."""
    die_with_parent()
    # libraries print what they like; only answers go where answers are read
    answers = os.fdopen(os.dup(1), 'w')
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)

    def say(answer: dict[str, Any]) -> None:
        answers.write(json.dumps(answer) + '\n')
        answers.flush()
    try:
        align = getattr(importlib.import_module(module), peer)(dict(np.load(model)))
    except Exception as error:
        say({'error': in_a_line(error)})
        return
    say({'ready': True})
    for line in sys.stdin:
        question = json.loads(line)
        points = np.array(question['points'])
        started = perf_counter()
        try:
            motion = np.asarray(align(points, question['noise']), dtype=np.float64)
            say({'motion': motion.tolist(), 'seconds': perf_counter() - started})
        except Exception as error:      # a peer may fail as it likes; that is a result
            say({'error': in_a_line(error)})


def in_a_line(error: Exception) -> str:
    """Return what is wrong, without line breaks."""
    return ' '.join(f'{type(error).__name__}: {error}'.split())


def die_with_parent() -> None:
    """Be killed when whoever asked is gone, even in the middle of a library's call (Linux)."""
    prctl = getattr(ctypes.CDLL(None), 'prctl', None)
    if prctl is not None:
        prctl(1, 9)     # PR_SET_PDEATHSIG, SIGKILL


if __name__ == '__main__':
    main(*sys.argv[1:])
