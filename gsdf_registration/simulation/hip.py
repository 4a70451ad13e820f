# SPDX-License-Identifier: Apache-2.0
"""
The shape of a right hemipelvis.

Millimetres; x lateral (right), y anterior, z superior; origin at the centre of the acetabulum.
"""

from __future__ import annotations

import numpy as np

from gsdf_registration.common.rigid import Array
from gsdf_registration.simulation.implicit import (
    Points,
    carve,
    ellipsoid,
    join,
    polygon,
    tube,
    unevenness,
)

CUP_RADIUS = 26.0
CUP_AXIS = np.array([0.745, 0.300, -0.596])     # direction in which the acetabulum opens
NOTCH = np.array([-0.664, 0.242, -0.707])       # direction of the notch in its rim
RIM_ANTERIOR = np.array([-0.068, 0.922, 0.380])     # along the rim from the notch: axis x notch
BOX = ((-100.0, -112.0, -96.0), (58.0, 74.0, 146.0))
LANDMARKS = {'anterior_superior_iliac_spine': (33.0, 58.0, 78.0),
             'posterior_acetabular_rim': (20.0, -28.0, 8.0),
             'ischial_tuberosity': (-16.0, -46.0, -68.0)}

# Horizontal direction of the wing; u is the coordinate along it (anterior), w across it (outward)
ALONG = np.array([0.515, 0.857])
# u, z of the outline of the wing: from the roof of the acetabulum over the anterior spines along
# the crest to the posterior spines, and back through the greater sciatic notch
OUTLINE = [(26.0, 10.0), (42.0, 30.0), (47.0, 43.0), (45.0, 54.0), (56.0, 64.0), (63.0, 76.0),
           (60.0, 88.0), (49.0, 105.0), (30.0, 122.0), (6.0, 131.0), (-22.0, 132.0), (-52.0, 123.0),
           (-80.0, 106.0), (-102.0, 86.0), (-107.0, 72.0), (-98.0, 62.0), (-98.0, 48.0),
           (-84.0, 37.0), (-62.0, 41.0), (-43.0, 38.0), (-33.0, 20.0), (-34.0, 0.0), (0.0, -10.0)]
# Curves and radii of the spines: anterior superior and inferior, posterior superior and inferior
SPINES = (([(26.0, 48.0, 84.0), (30.0, 53.0, 74.0), (28.0, 51.0, 66.0)], [5.0, 6.5, 4.0]),
          ([(14.0, 32.0, 46.0), (20.0, 37.0, 38.0), (17.0, 31.0, 26.0)], [5.0, 7.5, 6.0]),
          ([(-44.0, -80.0, 92.0), (-50.0, -90.0, 80.0), (-49.0, -88.0, 70.0)], [7.0, 8.5, 5.0]),
          ([(-46.0, -82.0, 56.0), (-47.0, -79.0, 46.0)], [6.0, 6.5]))


def solid(p: Points) -> Array:
    """Return the hemipelvis as an implicit solid, see `implicit`."""
    bone = join(_wing(p), _columns(p), 12.0)
    bone = join(bone, _pubis_and_ischium(p), 10.0)
    return _acetabulum(p, bone) + unevenness(p, 0.5)


def _wing(p: Points) -> Array:
    """
    Return the iliac wing with its four spines.

    It is a bent plate, thin in the middle and thick at the crest.
    """
    x, y, z = p
    u = ALONG[0] * x + ALONG[1] * y
    w = ALONG[1] * x - ALONG[0] * y
    rise = np.clip((z - 20.0) / 110.0, 0.0, 1.2)
    middle = -8.0 + 36.0 * rise**1.4 * _gaussian(u, 16.0, 52.0) - 9.0 * rise * np.tanh(
        (u - 40.0) / 12.0)
    outline = polygon(u, z, OUTLINE)
    inward = np.maximum(-outline, 0.0)
    crest = _gaussian(inward, 0.0, 8.0) * (0.8 + 0.5 * np.sin(0.055 * u + 0.6) * np.tanh(
        (z - 60.0) / 30.0))
    pillar = _gaussian(u - 0.35 * z, 4.0, 16.0)
    thick = 2.8 + 4.0 * crest + 3.0 * pillar + 6.0 * _gaussian(z, 10.0, 28.0) + 6.5 * _gaussian(
        u, -88.0, 30.0)
    # the plate is oblique: the offset along w exceeds the distance
    plate = (np.abs(w - middle) - thick) * 0.86
    wing = carve(plate, -outline, 9.0)
    for path, radii in SPINES:
        wing = join(wing, tube(p, path, radii), 12.0)
    # sacro-iliac joint
    ear = ellipsoid(p, (-46.0, -63.0, 60.0), (9.0, 24.0, 17.0), (24.0, 0.0, -28.0))
    tuberosity = ellipsoid(p, (-48.0, -74.0, 84.0), (10.0, 15.0, 11.0), (-30.0, 0.0, -28.0))
    return join(join(wing, ear, 6.0), tuberosity, 8.0)


def _gaussian(x: Array, centre: float, width: float) -> Array:
    """Return a Gaussian of height one."""
    return np.exp(-(((x - centre) / width) ** 2))


def _columns(p: Points) -> Array:
    """Return the columns that meet at the acetabulum, the pelvic brim, and the acetabular wall."""
    shell = ellipsoid(p, (-3.5, -1.0, 2.0), (33.0, 33.5, 33.5))
    brim = tube(p, [(-44.0, -58.0, 52.0), (-31.0, -32.0, 33.0), (-25.0, -4.0, 15.0),
                    (-36.0, 24.0, 2.0)], [10.0, 10.5, 9.0, 9.0])
    posterior = tube(p, [(-18.0, -24.0, 30.0), (-16.0, -28.0, 4.0), (-17.0, -31.0, -24.0)],
                     [12.0, 12.0, 13.0])
    spine = tube(p, [(-18.0, -32.0, -6.0), (-27.0, -42.0, -14.0), (-36.0, -50.0, -20.0)],
                 [13.0, 8.0, 3.0])
    roof = tube(p, [(8.0, 4.0, 28.0), (5.0, 14.0, 44.0)], [13.0, 10.0])
    bone = join(join(shell, brim, 12.0), posterior, 12.0)
    return join(join(bone, spine, 7.0), roof, 14.0)


def _pubis_and_ischium(p: Points) -> Array:
    """Return the ring around the obturator foramen: pubic rami, symphysis and ischium."""
    superior = tube(p, [(-18.0, 19.0, -1.0), (-42.0, 35.0, -3.0), (-72.0, 44.0, -11.0)],
                    [15.0, 8.5, 9.0])
    body = ellipsoid(p, (-77.0, 40.0, -23.0), (12.0, 8.5, 21.0), (28.0, 18.0, 16.0))
    tubercle = ellipsoid(p, (-64.0, 49.0, -5.0), (7.0, 4.5, 4.5))
    inferior = _flat_ramus(p)
    ischium = tube(p, [(-12.0, -18.0, -14.0), (-14.0, -27.0, -40.0), (-17.0, -31.0, -64.0)],
                   [20.0, 15.0, 14.0])
    tuber = ellipsoid(p, (-14.0, -39.0, -57.0), (14.5, 13.0, 25.0), (-16.0, 6.0, 20.0))
    ring = join(join(superior, body, 10.0), tubercle, 7.0)
    ring = join(join(ring, inferior, 9.0), join(ischium, tuber, 8.0), 12.0)
    symphysis = -(p[0] + 84.5 - 0.12 * (p[2] + 24.0))       # flat at the other hemipelvis
    return carve(ring, -symphysis, 3.0)


def _flat_ramus(p: Points) -> Array:
    """Return the ramus between pubis and ischium as two blended tubes."""
    inner = tube(p, [(-76.0, 33.0, -36.0), (-62.0, 13.0, -54.0), (-44.0, -8.0, -67.0),
                     (-24.0, -24.0, -70.0)], [7.0, 5.0, 5.5, 10.0])
    outer = tube(p, [(-76.0, 36.0, -44.0), (-64.0, 12.0, -63.0), (-45.0, -12.0, -77.0),
                     (-24.0, -30.0, -80.0)], [6.5, 4.5, 4.5, 8.0])
    return join(inner, outer, 9.0)


def _acetabulum(p: Points, bone: Array) -> Array:
    """Add the rim of the acetabulum and carve the cup, its fossa and its notch."""
    along = p[0] * CUP_AXIS[0] + p[1] * CUP_AXIS[1] + p[2] * CUP_AXIS[2]
    down = p[0] * NOTCH[0] + p[1] * NOTCH[1] + p[2] * NOTCH[2]
    bone = carve(bone, ellipsoid(p, 32.0 * CUP_AXIS, (31.0, 31.0, 31.0)), 4.0)
    across = np.sqrt(np.maximum(p[0] ** 2 + p[1] ** 2 + p[2] ** 2 - along**2, 0.0))
    # the rim is not planar: its height varies and is largest superior and posterior
    side = p[0] * RIM_ANTERIOR[0] + p[1] * RIM_ANTERIOR[1] + p[2] * RIM_ANTERIOR[2]
    turn = np.arctan2(side, -down)
    height = 1.5 + 2.2 * np.cos(2.0 * turn + 0.7) - 1.8 * np.sin(turn)
    rim = np.sqrt((across - 29.5) ** 2 + 0.6 * (along - height) ** 2) - 4.6
    bone = join(bone, rim, 9.0)
    bone = carve(bone, ellipsoid(p, (0.0, 0.0, 0.0), [CUP_RADIUS] * 3), 2.5)
    notch = tube(p, [8.0 * NOTCH - 6.0 * CUP_AXIS, 24.0 * NOTCH + 2.0 * CUP_AXIS,
                     42.0 * NOTCH + 14.0 * CUP_AXIS], [7.0, 9.5, 14.0])
    bone = carve(bone, notch, 6.0)
    fossa = ellipsoid(p, -11.0 * CUP_AXIS + 5.0 * NOTCH, (16.5, 16.5, 16.5))
    return carve(bone, fossa, 3.5)
