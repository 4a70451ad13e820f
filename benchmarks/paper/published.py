# SPDX-License-Identifier: Apache-2.0
"""
Figures of the publication (Li et al., arXiv 2410.03078, tables 2 to 4), means over its bones.

For a region: MAE of the Euler angles (degrees), MAE of the translation (mm), Chamfer distance (mm).
For a level of noise or outliers, over all regions: both MAEs and the time (s).
"""

from __future__ import annotations

Figures = tuple[float, float, float]

_REGIONS = ('acetabulum', 'proximal_femur', 'condyles', 'proximal_tibia')


def _row(*figures: Figures) -> dict[str, Figures]:
    return dict(zip(_REGIONS, figures))


# scenario -> method -> region
REGIONS: dict[str, dict[str, dict[str, Figures]]] = {
    'clean': {
        'ICP': _row((42.1, 4.67, 5.21), (21.9, 93.5, 4.34), (47.7, 99.0, 9.08), (64.3, 80.7, 4.99)),
        'CPD': _row((21.3, 9.86, 6.38), (30.6, 95.7, 4.41), (59.8, 108.1, 8.07),
                    (60.5, 72.1, 4.86)),
        'JRMPC': _row((18.9, 3.32, 3.23), (22.7, 80.5, 4.16), (21.6, 91.4, 8.14),
                      (41.6, 73.8, 4.07)),
        'Go-ICP': _row((2.13, 0.269, 0.765), (2.84, 2.02, 1.01), (1.24, 0.948, 1.07),
                       (1.125, 1.56, 0.804)),
        'the paper': _row((0.204, 0.202, 0.706), (0.518, 0.667, 0.846), (0.605, 0.473, 0.904),
                          (1.127, 0.763, 0.736)),
    },
    'anisotropic': {
        'Go-ICP': _row((3.72, 0.403, 0.807), (3.15, 3.04, 1.01), (1.78, 0.431, 0.979),
                       (6.15, 2.86, 0.846)),
        'the paper': _row((0.752, 0.177, 0.691), (0.731, 0.557, 0.889), (0.630, 0.408, 0.952),
                          (1.304, 0.945, 0.811)),
    }
}
# scenario -> the paper's method
LEVELS: dict[str, Figures] = {
    'clean': (0.614, 0.526, 0.077), 'sigma_0.7': (0.670, 0.782, 0.151),
    'sigma_0.9': (1.021, 0.976, 0.441), 'sigma_1.2': (1.168, 1.029, 0.653),
    'uniform_10': (0.574, 0.456, 0.109), 'uniform_30': (0.682, 0.456, 0.069),
    'uniform_50': (0.615, 0.487, 0.281), 'uniform_70': (0.682, 0.481, 0.288),
    'uniform_90': (0.961, 0.608, 2.320)
}
