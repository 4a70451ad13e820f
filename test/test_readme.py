# SPDX-License-Identifier: Apache-2.0
"""Test that links, commands, examples and names in the documents are valid."""

from __future__ import annotations

import argparse
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks.__main__ import BENCHMARKS
from benchmarks.__main__ import make_parser as make_benchmark_parser
from gsdf_registration.cli.main import SUBCOMMANDS, make_parser
from gsdf_registration.common.command_line import Parser

ROOT = Path(__file__).parents[1]
README = (ROOT / 'README.md').read_text()
COMMAND_PAGE = (ROOT / 'docs/commands.md').read_text()
DOCUMENTS = ('README.md', 'ARCHITECTURE.md', 'CONTRIBUTING.md', 'CHANGELOG.md', 'BENCHMARKS.md',
             'bags/README.md',
             *(f'docs/{page.name}' for page in sorted((ROOT / 'docs').glob('*.md'))))
SUBCOMMAND_NAMES = [name.replace('_', '-') for name in SUBCOMMANDS]
PARSERS = {'gsdf': make_parser, 'python -m benchmarks': make_benchmark_parser}
COMMANDS = ['gsdf', *(f'gsdf {name}' for name in SUBCOMMAND_NAMES), 'python -m benchmarks',
            *(f'python -m benchmarks {name}' for name in BENCHMARKS)]


def program_of(command: str) -> tuple[Parser, list[str]] | None:
    """Return the parser of the program in a command, and its arguments; None for other programs."""
    for program, make in PARSERS.items():
        if command == program or command.startswith(f'{program} '):
            return make(), shlex.split(command.removeprefix(program))
    return None


def parser_of(command: str) -> argparse.ArgumentParser:
    """Return the parser of a program, such as ``gsdf``, or of its subcommand."""
    found = program_of(command)
    assert found is not None
    parser: argparse.ArgumentParser = found[0]
    for word in found[1]:
        choices = next(action.choices for action in parser._actions
                       if isinstance(action, argparse._SubParsersAction))
        parser = choices[word]
    return parser


def parse(command: str) -> None:
    """Parse a command of one of the programs; ignore other commands."""
    found = program_of(command)
    if found is not None:
        found[0].parse_args(found[1])


def blocks_of(document: str) -> list[str]:
    """Return the commands in the blocks of a document, a line each."""
    text = (ROOT / document).read_text().replace('\\\n', ' ')
    return [line.split('  #')[0] for block in re.findall(r'```\n(.*?)```', text, re.DOTALL)
            for line in block.splitlines()]


@pytest.mark.parametrize('document', DOCUMENTS)
def test_links_lead_to_files(document: str) -> None:
    folder = (ROOT / document).parent
    links = re.findall(r'\]\((?!http)([^)#]+)', (ROOT / document).read_text())
    assert [link for link in links if not (folder / link).exists()] == []


def test_the_python_example_finds_the_bone(tmp_path: Path) -> None:
    example, = re.findall(r'```python\n(.*?)```', README, re.DOTALL)
    done = subprocess.run([sys.executable, '-c', example + 'assert result.success\n'],
                          cwd=ROOT,
                          env={**os.environ, 'GSDF_CACHE_DIR': str(tmp_path)},
                          capture_output=True,
                          text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize('command', COMMANDS)
def test_every_command_shows_valid_examples(command: str) -> None:
    shown = re.split('examples?:', parser_of(command).epilog or '')[-1].strip().splitlines()
    assert shown and shown[0].startswith(command)
    for line in shown:
        parse(line.strip())


@pytest.mark.parametrize('name', SUBCOMMAND_NAMES)
def test_the_page_of_commands_lists_every_subcommand(name: str) -> None:
    assert re.search(rf'^\| `gsdf {name}\b', COMMAND_PAGE, re.MULTILINE)


@pytest.mark.parametrize('name', BENCHMARKS)
def test_benchmarks_page_shows_every_benchmark(name: str) -> None:
    assert f'python -m benchmarks {name}' in (ROOT / 'BENCHMARKS.md').read_text()


@pytest.mark.parametrize('document', DOCUMENTS)
def test_commands_in_documents_are_valid(document: str) -> None:
    for line in blocks_of(document):
        if '...' not in line:
            parse(line)


@pytest.mark.parametrize('document', [page for page in DOCUMENTS if page != 'CHANGELOG.md'])
def test_subcommands_that_are_named_exist(document: str) -> None:
    named = set(re.findall(r'`gsdf ([\w-]+)', (ROOT / document).read_text()))
    assert named <= set(SUBCOMMAND_NAMES)


def test_targets_that_are_named_exist() -> None:
    targets = set(re.findall(r'make (\w+)', README)) & {'demo', 'test', 'lint', 'bench'}
    assert {'demo', 'test'} <= targets
    for target in targets:
        assert re.search(rf'^{target}:', (ROOT / 'Makefile').read_text(), re.MULTILINE)


def test_launch_arguments_and_parameters_that_are_named_exist() -> None:
    launched = (ROOT / 'launch/registration.launch.py').read_text()
    named = set(re.findall(r'(\w+):=', README + (ROOT / 'docs/node.md').read_text()))
    assert named and all(f"DeclareLaunchArgument('{name}'" in ' '.join(launched.split()).replace(
        '( ', '(') for name in named)


def test_packages_that_the_architecture_names_exist() -> None:
    rooms = (ROOT / 'ARCHITECTURE.md').read_text()
    for name in set(re.findall(r'[\w/]+(?:\.py|/(?=\*\*))', rooms)):
        assert (any((ROOT / 'gsdf_registration').rglob(name.strip('/')))
                or (ROOT / name).exists()), name
