# SPDX-License-Identifier: Apache-2.0
"""Test the numbers, the examples and the errors of a command line."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable

import pytest

from gsdf_registration.common.command_line import (
    Parser,
    example,
    natural_number,
    number,
    positive_number,
    run_command,
    spinner,
    suggestion,
    whole_number,
)
from gsdf_registration.common.result import InputError, Reason, Refusal


@pytest.mark.parametrize(('convert', 'text', 'value'), [
    (number, '1e-3', 0.001), (whole_number, '-4', -4), (natural_number, '0', 0),
    (positive_number, '1', 1)])
def test_reads_numbers(convert: Callable[[str], float], text: str, value: float) -> None:
    assert convert(text) == value


@pytest.mark.parametrize(('convert', 'text', 'message'), [
    (number, 'a', '"a" is not a number'),
    (whole_number, '1.5', '"1.5" is not a whole number'),
    (natural_number, '-1', 'must be 0 or more, not -1'),
    (positive_number, '0', 'must be 1 or more, not 0')])
def test_rejects_other_numbers(convert: Callable[[str], float], text: str, message: str) -> None:
    with pytest.raises(argparse.ArgumentTypeError) as caught:
        convert(text)
    assert str(caught.value) == message


def test_suggests_the_nearest_word_if_one_is_near() -> None:
    assert suggestion('biuld', ['build', 'show']) == 'did you mean build?'
    assert suggestion('xyz', ['build', 'show']) == ''


def test_a_long_example_is_continued_before_an_option() -> None:
    command = 'gsdf register model.stl points.csv --landmarks landmarks.csv --report report.html'
    parser = Parser(prog='gsdf', **example(command + ' --json result.json'))
    shown = parser.format_help()
    assert ' \\\n      --' in shown
    assert max(map(len, shown.splitlines())) <= 100


def parser_that(run: Callable[[argparse.Namespace], int]) -> Parser:
    parser = Parser(prog='python -m tool')
    parser.set_defaults(run=run)
    return parser


@pytest.mark.parametrize(('error', 'code', 'line'), [
    (InputError('no such file'), 2, 'tool: error: no such file\n'),
    (Refusal(Reason.BAD_INPUT, 'not a pose'), 2, 'tool: error: not a pose\n'),
    (PermissionError(13, 'Permission denied', '/x'), 2, 'tool: error: /x: Permission denied\n'),
])
def test_errors_are_one_line_and_an_exit_code(capsys: pytest.CaptureFixture[str],
                                              error: Exception, code: int, line: str) -> None:
    def run(_: argparse.Namespace) -> int:
        raise error
    assert run_command(parser_that(run), []) == code
    assert capsys.readouterr().err == line


def test_returns_the_exit_code_of_the_command() -> None:
    assert run_command(parser_that(lambda _: 1), []) == 1


def test_an_interrupt_has_exit_code_130(capsys: pytest.CaptureFixture[str]) -> None:
    def run(_: argparse.Namespace) -> int:
        raise KeyboardInterrupt
    assert run_command(parser_that(run), []) == 130
    assert 'Traceback' not in capsys.readouterr().err


def test_spinner_prints_nothing_without_a_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    assert not sys.stderr.isatty()
    with spinner('working'):
        pass
    assert capsys.readouterr() == ('', '')
