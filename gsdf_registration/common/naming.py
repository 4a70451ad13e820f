# SPDX-License-Identifier: Apache-2.0
"""Default names of frames and files, which differ between any two nodes."""

from __future__ import annotations

CENTRE = '_centre'              # added to the frame of a bone
NODE_NAME = 'registration'      # of the executable and the launch file


def prefix_of(namespace: str, name: str) -> str:
    """
    Return the prefix of the default names of a node.

    It is derived from the fully qualified name: ``femur_`` for /femur/registration and for /femur,
    ``left_femur_`` for /left/femur/registration, and an empty string for /registration.
    """
    words = f'{namespace}/{name}'.strip('/').split('/')
    if words[-1] == NODE_NAME:
        words.pop()
    return ''.join(f'{word}_' for word in words)


def centre_frame(bone_frame: str) -> str:
    """Return the name of the frame at the centre of the bone, with the axes of the bone frame."""
    return bone_frame + CENTRE
