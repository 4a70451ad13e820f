# SPDX-License-Identifier: Apache-2.0
"""The progress is reported at most five times a second, but every new sentence at once."""

from __future__ import annotations

from gsdf_registration.node.progress import Progress


def test_reports_are_limited_to_five_a_second() -> None:
    reported: list[float | None] = []
    clock = [0.0]
    progress = Progress(lambda: reported.append(progress.share), lambda: clock[0])
    for step in range(101):
        clock[0] = 0.01 * step
        progress.show(0.01 * step)
    assert len(reported) == 5 and progress.share == 1.0


def test_a_new_sentence_is_reported_at_once() -> None:
    reported: list[str] = []
    progress = Progress(lambda: reported.append(progress.sentence), lambda: 7.0)
    progress.show(0.0, 'compiling')
    progress.show(0.5, 'compiling')
    progress.show(0.9, 'loading')
    assert reported == ['compiling', 'loading']
    progress.end()
    assert (progress.share, progress.sentence) == (None, '')
