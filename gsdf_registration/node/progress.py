# SPDX-License-Identifier: Apache-2.0
"""How far the work is that the operator waits for: a search, or kernels that are compiled."""

from __future__ import annotations

import time
from collections.abc import Callable

PERIOD = 0.2        # s, between two reports


class Progress:
    """
    The work in the background and its progress; set by any thread.

    Attributes
    ----------
    sentence : str
        What is being done; may be empty.
    share : float or None
        How far it is, 0 to 1; None: nothing runs.

    """

    def __init__(self, report: Callable[[], None], now: Callable[[], float] = time.monotonic
                 ) -> None:
        self.sentence = ''
        self.share: float | None = None
        self._report, self._now = report, now
        self._reported = float('-inf')

    def show(self, share: float, sentence: str = '') -> None:
        """Set the progress; it is reported at once with a new sentence, else every `PERIOD`."""
        new, self.sentence, self.share = sentence != self.sentence, sentence, share
        if new or self._now() - self._reported >= PERIOD:
            self._reported = self._now()
            self._report()

    def end(self) -> None:
        """Nothing runs any more; whoever started the work reports its end."""
        self.sentence, self.share = '', None
