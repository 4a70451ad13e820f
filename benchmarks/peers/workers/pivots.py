# SPDX-License-Identifier: Apache-2.0
"""
Pivot calibrations of scikit-surgerycalibration.

Run as ``python pivots.py POSES.npz``: the arrays (n, 4, 4), m, of the file are recordings. The
answer is one line of JSON: for each method, for each recording, the tip (3,) in m, or None if the
method failed, and the seconds it took.
"""

from __future__ import annotations

import contextlib
import json
import random
import sys
from time import perf_counter
from typing import Any

import numpy as np

MM = 1e3
# the thresholds are in mm; the iterations are ten times the default of the library
METHODS: dict[str, dict[str, Any]] = {
    'algebraic one step': {'method': 'aos'},
    'RANSAC': {'method': 'ransac', 'number_iterations': 100, 'error_threshold': 2.0},
    'sphere': {'method': 'sphere_fitting'},
}


def main(path: str) -> None:
    """Calibrate all recordings with all methods."""
    from sksurgerycalibration.algorithms.pivot import pivot_calibration
    with np.load(path) as file:
        recordings = [file[name] for name in sorted(file.files)]
    answers: dict[str, list[Any]] = {}
    for method, configuration in METHODS.items():
        random.seed(0)
        answers[method] = []
        for T in recordings:
            in_mm = T.copy()
            in_mm[:, :3, 3] *= MM
            started = perf_counter()
            try:
                with contextlib.redirect_stdout(sys.stderr):
                    tip, _, _ = pivot_calibration(in_mm, configuration)
                found = (np.ravel(tip) / MM).tolist()
            except ValueError:
                found = None
            answers[method].append((found, perf_counter() - started))
    print(json.dumps(answers))


if __name__ == '__main__':
    main(sys.argv[1])
