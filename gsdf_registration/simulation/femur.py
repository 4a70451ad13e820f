# SPDX-License-Identifier: Apache-2.0
"""
The shape of a right femur.

Millimetres; x lateral (right), y anterior, z superior; origin between the condyles, below the head.
"""

from __future__ import annotations

import numpy as np

from gsdf_registration.common.rigid import Array
from gsdf_registration.simulation.implicit import (
    Points,
    carve,
    ellipsoid,
    join,
    moved,
    tube,
    unevenness,
)

HEAD = (-5.0, 11.0, 414.0)      # centre; anteversion 12 degrees, neck-shaft angle 126 degrees
HEAD_RADIUS = 23.5
BOX = ((-60.0, -55.0, -12.0), (80.0, 50.0, 446.0))
LANDMARKS = {'greater_trochanter_tip': (50.0, -14.0, 412.0),
             'lesser_trochanter': (14.0, -24.0, 346.0),
             'anterior_neck_base': (26.0, 22.0, 378.0),
             'medial_epicondyle': (-40.0, -4.0, 30.0),
             'lateral_epicondyle': (38.0, -2.0, 32.0),
             'top_of_trochlea': (2.0, 30.0, 52.0)}


def solid(p: Points) -> Array:
    """Return the femur as an implicit solid, see `implicit`."""
    bone = join(_shaft(p), _proximal(p), 12.0)
    bone = join(bone, _distal(p), 14.0)
    bone = _distal_grooves(p, bone)
    return bone + unevenness(p, 0.5)


def _shaft(p: Points) -> Array:
    """Return the bowed shaft: an ellipse at every height, with the linea aspera posterior."""
    x, y, z = p
    heights = [20.0, 45.0, 60.0, 80.0, 110.0, 160.0, 230.0, 300.0, 340.0, 365.0, 385.0]
    wide = np.interp(z, heights, [26.0, 34.0, 29.0, 22.5, 17.5, 14.5, 13.3, 14.2, 17.0, 20.0, 18.0])
    deep = np.interp(z, heights, [17.0, 20.0, 18.5, 16.5, 15.5, 14.6, 14.4, 14.0, 15.5, 17.0, 15.0])
    s = np.clip((z - 30.0) / 350.0, 0.0, 1.0)
    cx = 36.0 * s**1.15
    cy = 4.0 + 44.0 * s * (1.0 - s) - 5.0 * s
    u, v = x - cx, y - cy
    around = np.arctan2(u + 2.0, -v)      # zero posterior, slightly lateral of the axis
    ridge = 3.2 * np.exp(-(around / 0.28) ** 2) * np.exp(-(((z - 215.0) / 95.0) ** 4))
    k = np.sqrt((u / wide) ** 2 + (v / deep) ** 2)
    shell = (k - 1.0) * np.minimum(wide, deep) - ridge
    ends = np.maximum(24.0 - z, z - 384.0)
    return carve(shell, -ends, 10.0)


def _proximal(p: Points) -> Array:
    """Return head, neck and trochanters."""
    neck = tube(p, [HEAD, (14.0, 7.0, 397.0), (36.0, 1.0, 376.0)], [15.0, 14.5, 19.0])
    head = ellipsoid(p, HEAD, [HEAD_RADIUS] * 3)
    head = carve(head, ellipsoid(p, (-29.5, 4.0, 420.0), [6.0, 6.0, 6.0]), 3.0)     # fovea
    bone = join(head, neck, 6.0)
    greater = ellipsoid(p, (49.0, -3.0, 383.0), (14.5, 19.0, 27.0), (8.0, -8.0, 0.0))
    greater = join(greater, tube(p, [(52.0, 2.0, 390.0), (50.0, -9.0, 404.0), (45.0, -16.0, 408.0)],
                                 [11.0, 9.0, 6.0]), 8.0)
    bone = join(bone, greater, 11.0)
    crest = tube(p, [(47.0, -17.0, 398.0), (36.0, -18.0, 376.0), (20.0, -15.0, 352.0)],
                 [6.0, 5.5, 6.0])
    bone = join(bone, crest, 8.0)
    lesser = tube(p, [(24.0, -4.0, 342.0), (16.0, -15.0, 346.0), (13.0, -19.0, 348.0)],
                  [12.0, 8.0, 5.0])
    bone = join(bone, lesser, 7.0)
    fossa = ellipsoid(p, (35.5, -13.0, 402.0), (7.5, 8.0, 13.0), (0.0, 20.0, 0.0))
    bone = carve(bone, fossa, 5.0)
    return join(bone, tube(p, [(46.0, 15.0, 388.0), (30.0, 17.0, 368.0)], [4.5, 3.5]), 7.0)


def _distal(p: Points) -> Array:
    """Return the condyles, the walls of the patellar groove and the epicondyles."""
    medial = join(ellipsoid(p, (-25.0, -21.0, 21.0), (14.0, 21.0, 21.0), (0.0, 0.0, 12.0)),
                  ellipsoid(p, (-22.0, 5.0, 26.0), (14.5, 25.0, 26.5), (0.0, 0.0, 14.0)), 10.0)
    lateral = join(ellipsoid(p, (24.5, -18.0, 23.0), (13.5, 19.5, 20.0), (0.0, 0.0, -6.0)),
                   ellipsoid(p, (21.0, 9.0, 27.5), (15.0, 25.0, 25.0), (0.0, 0.0, -8.0)), 10.0)
    lateral = join(lateral, ellipsoid(p, (16.0, 20.0, 37.0), (12.5, 15.0, 21.0), (14.0, 0.0, 0.0)),
                   9.0)
    medial = join(medial, ellipsoid(p, (-14.0, 16.0, 34.0), (11.5, 14.0, 18.0), (14.0, 0.0, 0.0)),
                  9.0)
    bone = join(medial, lateral, 8.0)
    bone = join(bone, ellipsoid(p, (0.0, 2.0, 42.0), (35.0, 21.0, 22.0)), 9.0)
    medial_knob = join(ellipsoid(p, (-37.0, -6.0, 33.0), (7.5, 10.0, 11.0)),
                       ellipsoid(p, (-33.5, -10.0, 52.0), (4.5, 5.0, 8.0)), 8.0)
    lateral_knob = ellipsoid(p, (36.0, -3.0, 31.0), (6.0, 8.5, 9.5))
    return join(join(bone, medial_knob, 9.0), lateral_knob, 9.0)


def _distal_grooves(p: Points, bone: Array) -> Array:
    """Carve the intercondylar notch, the patellar groove and the popliteal surface."""
    notch = ellipsoid(p, (1.0, -33.0, 8.0), (10.5, 37.0, 25.0), (-14.0, 0.0, 0.0))
    bone = carve(bone, notch, 6.0)
    groove = tube(p, [(3.0, 49.0, 62.0), (2.5, 44.0, 36.0), (1.5, 30.0, 2.0), (1.0, 6.0, -13.0)],
                  [13.0, 14.0, 15.0, 13.0])
    bone = carve(bone, groove, 9.0)
    q = moved(p, (0.0, -29.0, 66.0))
    return carve(bone, ellipsoid(q, (0.0, 0.0, 0.0), (21.0, 12.5, 24.0)), 10.0)
