# SPDX-License-Identifier: Apache-2.0
"""What the stamps of a recording show: zeros, stamps out of order and gaps."""

from __future__ import annotations

import numpy as np

from gsdf_registration.common.formatting import format_count
from msg_adapters.recording import Recording

GAP = 5.0       # s without a sample; shorter ones come from a probe that is turned away
BACK = 1.0      # s; a larger step back is a clock that went back, which the replay reports


def stamp_notes(recording: Recording) -> list[str]:
    """Return a sentence on each defect of the stamps of each source."""
    notes = []
    for number, name in enumerate(recording.source_names):
        if recording.stamps is None:
            continue
        stamps = recording.stamps[recording.sources == number]
        zeros, steps = int((stamps == 0.0).sum()), np.diff(stamps)
        late = int(((steps < 0.0) & (steps >= -BACK)).sum())
        gaps = steps[steps > GAP]
        if zeros:
            notes.append(f'{zeros} of {format_count(len(stamps), "sample")} on {name} have the '
                         'stamp 0: their driver does not set header.stamp')
        if late:
            notes.append(f'{format_count(late, "sample")} on {name} out of order: earlier than the '
                         'one before')
        if len(gaps) and not zeros:
            notes.append(f'{format_count(len(gaps), "gap")} of more than {GAP:.0f} s on {name}, '
                         f'the longest {gaps.max():.1f} s')
    return notes
