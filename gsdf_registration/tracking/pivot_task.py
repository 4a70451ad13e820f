# SPDX-License-Identifier: Apache-2.0
"""What a search for a fixed point looks for: its words, and the lengths that decide."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Task:
    """
    What is looked for: the words of the messages, and the lengths that decide, m.

    point, body, slipped : what they are called, and what the point does when it leaves its place
    advice : how to move the body
    tolerance : the point may be this far from its place and still count as there
    limit : the largest acceptable error of the point (95 %)
    systematic : an error of the tracked position that varies with the orientation, as a distorted
        volume or a pelvis that follows the leg causes.  It does not show in the residuals, and
        moves the point by up to ``systematic / sqrt(constraint)``, see `FixedPoint.constraint`.
    """

    point: str
    body: str
    slipped: str
    advice: str
    tolerance: float
    limit: float
    systematic: float


PIVOT = Task('tip', 'tool', 'slipped', 'keep the tip in the divot and tilt the tool to all sides',
             tolerance=0.005, limit=0.001, systematic=0.0001)
JOINT = Task('joint centre', 'limb', 'moved',
             'hold the other bone still and swing the limb to all sides',
             tolerance=0.015, limit=0.005, systematic=0.0005)
