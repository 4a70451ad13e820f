# SPDX-License-Identifier: Apache-2.0
"""
Register with one peer on one bone: report that it is ready, then answer requests, as JSON lines.

Run it as ``python worker.py MODULE PEER MODEL.npz``. A request contains ``points`` (n, 3), m, bone
frame, transformed by the start, and ``noise``, m. The response contains the ``motion`` (4, 4) of
the points, its time ``seconds`` and, if the peer states one, its accuracy ``stated``, or an
``error``.
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
    """Prepare the peer, then answer until there are no more requests."""
    die_with_parent()
    # libraries print to standard output, too: keep it for the responses only
    responses = os.fdopen(os.dup(1), 'w')
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)

    def respond(response: dict[str, Any]) -> None:
        responses.write(json.dumps(response) + '\n')
        responses.flush()
    try:
        align = getattr(importlib.import_module(module), peer)(dict(np.load(model)))
    except Exception as error:
        respond({'error': on_one_line(error)})
        return
    respond({'ready': True})
    for line in sys.stdin:
        request = json.loads(line)
        points = np.array(request['points'])
        started = perf_counter()
        try:
            found, seconds = align(points, request['noise']), perf_counter() - started
            motion, stated = found if isinstance(found, tuple) else (found, ())
            respond({'motion': np.asarray(motion, dtype=np.float64).tolist(),
                     'stated': np.asarray(stated, dtype=np.float64).tolist(), 'seconds': seconds})
        except Exception as error:      # any failure of a peer is a result
            respond({'error': on_one_line(error)})


def on_one_line(error: Exception) -> str:
    """Return the error without line breaks."""
    return ' '.join(f'{type(error).__name__}: {error}'.split())


def die_with_parent() -> None:
    """Let the kernel kill this process when its parent exits, even in a library call (Linux)."""
    prctl = getattr(ctypes.CDLL(None), 'prctl', None)
    if prctl is not None:
        prctl(1, 9)     # PR_SET_PDEATHSIG, SIGKILL


if __name__ == '__main__':
    main(*sys.argv[1:])
