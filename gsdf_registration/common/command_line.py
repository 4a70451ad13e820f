# SPDX-License-Identifier: Apache-2.0
"""
Helpers for command lines: a parser with one-line errors, exit codes, a spinner.

Exit codes: 0 success, 1 rejected, 2 bad usage or unreadable input, 130 interrupted.
"""

from __future__ import annotations

import argparse
import difflib
import importlib.util
import itertools
import logging
import math
import os
import re
import sys
import textwrap
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, NoReturn

from gsdf_registration.common.result import Refusal

BAR_WIDTH = 40      # characters, of a progress bar


class HelpFormatter(argparse.HelpFormatter):
    """Wraps between words only, and keeps the lines of examples."""

    def _split_lines(self, text: str, width: int) -> list[str]:
        return _wrapped(text, width)

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        if '\n' not in text:
            return '\n'.join(indent + line for line in _wrapped(text, width - len(indent)))
        return '\n'.join(line if len(line) <= width else _continued(line, width)
                         for line in text.splitlines())


def _wrapped(text: str, width: int) -> list[str]:
    start = text[:len(text) - len(text.lstrip())]
    return textwrap.wrap(text.strip(), width, initial_indent=start, break_long_words=False,
                         break_on_hyphens=False)


def _continued(line: str, width: int) -> str:
    """Return a long shell command on several lines, broken before options."""
    lines = ['']
    for part in re.split(' (?=-)', line):
        if lines[-1] and len(lines[-1]) + len(part) > width - 8:
            lines.append(f'      {part}')
        else:
            lines[-1] += f' {part}' if lines[-1] else part
    return ' \\\n'.join(lines)


class Parser(argparse.ArgumentParser):
    """An `ArgumentParser` that reports an error in one line and suggests the nearest word."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        self._option_names: list[str] = []
        self._commands: Any = None
        kwargs.setdefault('formatter_class', HelpFormatter)
        super().__init__(*args, **kwargs)
        # a value such as -1,2,3 is no option; argparse has no other way to say so
        self._negative_number_matcher = re.compile(r'-\.?\d')

    def add_argument(self, *args: Any, **kwargs: Any) -> argparse.Action:
        """Add an argument, and remember its names for suggestions."""
        action = super().add_argument(*args, **kwargs)
        self._option_names += action.option_strings
        return action

    def add_subparsers(self, **kwargs: Any) -> Any:
        """Add subcommands, and remember them for suggestions."""
        self._commands = super().add_subparsers(**kwargs)
        return self._commands

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse the arguments; an unknown command or option exits with status 2."""
        words = list(sys.argv[1:] if args is None else args)
        if self._commands is None:
            self._check_options(words)
        else:
            self._check_command(words)
        return super().parse_known_args(words, namespace)

    def error(self, message: str) -> NoReturn:
        """Exit with status 2."""
        self.exit(2, f'{self.program}: error: {message} (see {self.prog} --help)\n')

    @property
    def program(self) -> str:
        """Return the name of the program, without Python and subcommands."""
        return self.prog.removeprefix('python -m ').split()[0]

    def _check_command(self, words: list[str]) -> None:
        command = next((word for word in words if not word.startswith('-')), None)
        known = list(self._commands.choices)
        if command is not None and command not in known:
            self.error(f'"{command}" is not a command; '
                       + (suggestion(command, known) or f'choose one of {", ".join(known)}'))

    def _check_options(self, words: list[str]) -> None:
        for word in words[:words.index('--')] if '--' in words else words:
            option = word.partition('=')[0]
            # argparse accepts the beginning of a name, too
            if option.startswith('--') and not any(name.startswith(option)
                                                   for name in self._option_names):
                near = suggestion(option, self._option_names)
                self.error(f'unknown option {option}' + (near and f'; {near}'))


def suggestion(word: str, known: Sequence[str]) -> str:
    """Return the question whether the most similar known word was meant; empty if none is near."""
    near = difflib.get_close_matches(word, known, 1)
    return f'did you mean {near[0]}?' if near else ''


def example(*lines: str) -> dict[str, str]:
    """Return the parser argument that shows examples below the help."""
    title = 'example' if len(lines) == 1 else 'examples'
    return {'epilog': '\n  '.join([f'{title}:', *lines])}


def number(text: str) -> float:
    """Return a number of the command line."""
    try:
        return float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f'"{text}" is not a number') from None


def whole_number(text: str) -> int:
    """Return a whole number of the command line."""
    try:
        return int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f'"{text}" is not a whole number') from None


def three_numbers(text: str) -> list[float]:
    """Return three finite numbers of the command line, x,y,z."""
    values = [number(part) for part in text.split(',')]
    if len(values) != 3 or not all(math.isfinite(value) for value in values):
        raise argparse.ArgumentTypeError(f'must be three numbers x,y,z, not "{text}"')
    return values


def natural_number(text: str) -> int:
    """Return a whole number of the command line that is at least 0."""
    return _at_least(0, text)


def positive_number(text: str) -> int:
    """Return a whole number of the command line that is at least 1."""
    return _at_least(1, text)


def _at_least(low: int, text: str) -> int:
    value = whole_number(text)
    if value < low:
        raise argparse.ArgumentTypeError(f'must be {low} or more, not {text}')
    return value


def run_command(parser: Parser, argv: Sequence[str] | None) -> int:
    """Parse the command line, call the ``run`` of the subcommand and return the exit code."""
    logging.basicConfig(format=f'{parser.program}: %(message)s', level=logging.WARNING)
    try:
        args = parser.parse_args(argv)
        status: int = args.run(args)
        sys.stdout.flush()
        return status
    except Refusal as refusal:
        print(f'{parser.program}: error: {refusal.message}', file=sys.stderr)
        return 2
    except BrokenPipeError:     # the reader of our output has closed it
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:
        print(f'{parser.program}: error: {error.filename or "input or output"}: {error.strerror}',
              file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130


@contextmanager
def spinner(text: str) -> Iterator[None]:
    """Show a spinner on a terminal; print nothing if the output is not a terminal."""
    if not sys.stderr.isatty() or importlib.util.find_spec('rich') is None:
        yield
        return
    from rich.console import Console
    with Console(stderr=True).status(text):
        yield


@contextmanager
def progress_bar(text: str) -> Iterator[Callable[[float], None]]:
    """
    Show a progress bar on a terminal; print nothing if the output is not a terminal.

    It yields a function to be called with the finished share, 0 to 1.
    """
    if not sys.stderr.isatty():
        yield lambda share: None
        return

    def show(share: float) -> None:
        bar = '#' * round(BAR_WIDTH * share)
        print(f'\r{text} [{bar:<{BAR_WIDTH}}] {100.0 * share:3.0f} %', end='', file=sys.stderr,
              flush=True)
    show(0.0)
    try:
        yield show
    finally:
        print(file=sys.stderr)


@contextmanager
def counting_bar(text: str, total: int, done: int = 0) -> Iterator[Callable[[], None]]:
    """
    Show a progress bar of ``total`` jobs on a terminal; print nothing if it is not a terminal.

    It yields a function to be called for each finished job.
    """
    if importlib.util.find_spec('rich') is None or not sys.stderr.isatty():
        with progress_bar(text) as show:
            finished = itertools.count(done + 1)
            yield lambda: show(next(finished) / total)
        return
    from rich.console import Console
    from rich.progress import MofNCompleteColumn, Progress, TimeElapsedColumn
    columns = (*Progress.get_default_columns(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task(text, total=total, completed=done)
        yield lambda: bar.advance(task)
