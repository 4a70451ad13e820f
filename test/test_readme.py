# SPDX-License-Identifier: Apache-2.0
"""What the documents say is true."""

from __future__ import annotations

import argparse
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from gsdf_registration.cli.bench import BENCHES
from gsdf_registration.cli.main import SUBCOMMANDS, make_parser

ROOT = Path(__file__).parents[1]
README = (ROOT / 'README.md').read_text()
DOCUMENTS = ('README.md', 'CONTRIBUTING.md', 'CHANGELOG.md', 'BENCHMARKS.md', 'bags/README.md',
             'docs/interface.md', 'docs/troubleshooting.md')
COMMANDS = [name.replace('_', '-') for name in SUBCOMMANDS] + [f'bench {name}' for name in BENCHES]


def parser_of(command: str) -> argparse.ArgumentParser:
    """Return the parser of a subcommand, such as ``bench field``; empty: that of ``gsdf``."""
    parser = make_parser()
    for word in command.split():
        choices = next(action.choices for action in parser._actions
                       if isinstance(action, argparse._SubParsersAction))
        parser = choices[word]
    return parser


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


@pytest.mark.parametrize('command', ['', *COMMANDS])
def test_every_command_shows_examples_that_it_takes(command: str) -> None:
    shown = re.split('examples?:', parser_of(command).epilog or '')[-1].strip().splitlines()
    assert shown and shown[0].startswith(f'gsdf {command}'.strip())
    for line in shown:
        make_parser().parse_args(shlex.split(line)[1:])


@pytest.mark.parametrize('command', COMMANDS)
def test_every_command_stands_in_the_readme(command: str) -> None:
    *group, name = command.split()      # benches share a row
    assert re.search(rf'^\| `gsdf {" ".join(group)}.*\b{name}\b', README, re.MULTILINE)


@pytest.mark.parametrize('document', DOCUMENTS)
def test_commands_that_are_shown_are_taken(document: str) -> None:
    for line in blocks_of(document):
        if line.startswith('gsdf ') and '...' not in line:
            make_parser().parse_args(shlex.split(line)[1:])


@pytest.mark.parametrize('command', sorted(set(re.findall(r'`gsdf ([\w-]+)', README))))
def test_commands_that_are_named_exist(command: str) -> None:
    assert command in COMMANDS or command == 'bench'


def test_targets_that_are_named_exist() -> None:
    targets = set(re.findall(r'make (\w+)', README)) & {'demo', 'test', 'lint', 'bench'}
    assert {'demo', 'test'} <= targets
    for target in targets:
        assert re.search(rf'^{target}:', (ROOT / 'Makefile').read_text(), re.MULTILINE)


def test_launch_arguments_and_parameters_that_are_named_exist() -> None:
    launched = (ROOT / 'launch/registration.launch.py').read_text()
    named = set(re.findall(r'(\w+):=', README))
    assert named and all(f"DeclareLaunchArgument('{name}'" in ' '.join(launched.split()).replace(
        '( ', '(') for name in named)


def test_rooms_that_the_architecture_names_are_there() -> None:
    rooms = README.split('## Architecture')[1].split('## Limits')[0]
    for name in set(re.findall(r'[\w/]+(?:\.py|/(?=\*\*))', rooms)):
        assert (any((ROOT / 'gsdf_registration').rglob(name.strip('/')))
                or (ROOT / name).exists()), name
