# SPDX-License-Identifier: Apache-2.0
"""Jobs in processes: one that ends its process is found, the others are answered."""

from __future__ import annotations

import os

from gsdf_registration.common.process_pool import Died, run_processes


def half_or_die(number: int) -> float:
    if number in (1, 4):
        os._exit(9)
    return number / 2


def test_only_the_job_that_ends_its_process_has_no_answer() -> None:
    taken: list[int] = []

    def jobs() -> object:
        for number in range(6):
            taken.append(number)
            yield number
    answers = dict(run_processes(half_or_die, jobs(), 1))
    assert {number for number, answer in answers.items() if isinstance(answer, Died)} == {1, 4}
    assert [answers[number] for number in (0, 2, 3, 5)] == [0.0, 1.0, 1.5, 2.5]
    assert taken == list(range(6))


def test_jobs_are_taken_as_processes_become_free() -> None:
    taken: list[int] = []

    def jobs() -> object:
        for number in range(100):
            taken.append(number)
            yield number + 10
    answers = run_processes(half_or_die, jobs(), 1)
    assert next(answers) == (0, 5.0)
    assert len(taken) <= 3
    answers.close()
