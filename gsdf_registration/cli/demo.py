# SPDX-License-Identifier: Apache-2.0
"""``gsdf demo``: the real node over real DDS, fed with the recording that comes along."""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

from gsdf_registration.cli import common
from gsdf_registration.result import InputError, Reason, RegistrationResult

if TYPE_CHECKING:
    from diagnostic_msgs.msg import DiagnosticStatus

    from gsdf_registration.node.operator import Operator
    from msg_adapters.truth import Truth

SHARE = 'package://gsdf_registration/bags'
RATE = 6.0      # times as fast as recorded
STARTUP = 120.0     # s; the first start ever compiles the kernels and builds the field
PATIENCE = 15.0     # s


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        'demo', help='see a bone found: a ROS 2 node, a recorded tracker, an operator',
        description='Start the registration node on a ROS domain of its own, play a recorded run of an '
        'optical tracker into it, touch its landmarks, register, and compare the pose with the truth.',
        **common.example('gsdf demo'))
    parser.set_defaults(run=run)


def run(_: argparse.Namespace) -> int:
    """Show it; 0 if the bone was found."""
    try:
        from gsdf_registration.node.domain import own_domain
        from gsdf_registration.node.operator import Operator
    except ImportError as error:
        raise InputError(f'the demonstration needs ROS 2 ({error}): source a ROS 2 Jazzy install, or install '
                         'gsdf-registration[ros]') from None
    from gsdf_registration.model import find_model
    from msg_adapters.truth import read_truth

    truth_file = find_model(f'{SHARE}/hip_optical.yaml')
    bag, truth = truth_file.with_suffix(''), read_truth(truth_file)
    say = Narrator()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))       # the processes end with us
    with own_domain() as environment:
        os.environ.update(environment)
        say(f'starting the node on ROS domain {environment["ROS_DOMAIN_ID"]}')
        with running(node_command(truth_file.parent / truth.model, truth), 'the node') as node, \
                Operator(patience=STARTUP, alive=lambda: node.poll() is None) as operator:
            await_ready(operator)
            say(f'the node is active, its bone is {truth.model}; playing {bag.name}, {RATE:g} times as fast')
            touch_landmarks(operator, bag, truth, say)
            drag(operator, bag, say)
            answer = operator.ask('register')
            say(f'register: {answer.message}')
            if answer.success:
                show(truth_file.parent / truth.model, truth, say)
            return 0 if answer.success else 1


class Narrator:
    """Tells what happens, and when."""

    def __init__(self) -> None:
        self._start = time.monotonic()

    def __call__(self, text: str) -> None:
        """Print a line."""
        print(f'[{time.monotonic() - self._start:5.1f} s] {text}', flush=True)


def node_command(model: Path, truth: Truth) -> list[str]:
    """Return the command that starts the node for a recording: its landmarks come first, then the strokes."""
    numbers = ', '.join(repr(float(number)) for number in truth.landmarks_model.ravel())
    values = {'model.path': model, 'model.unit': truth.model_unit, 'collect.automatic': 'false',
              'probe.topics': "['/probe/tip', '/probe/landmarks']",
              'landmarks.names': list(truth.landmark_names), 'landmarks.positions': f'[{numbers}]'}
    parameters = [word for name, value in values.items() for word in ('-p', f'{name}:={value}')]
    return [sys.executable, '-m', 'gsdf_registration.node.main', '--ros-args', *parameters]


def player_command(bag: Path, topic: str) -> list[str]:
    """Return the command that plays one topic of a bag."""
    return [sys.executable, '-m', 'gsdf_registration.node.player', str(bag), '--topic', topic,
            '--rate', str(RATE)]


@contextmanager
def running(command: Sequence[str], name: str) -> Iterator[subprocess.Popen[bytes]]:
    """Run a process as long as the block; if that fails, show what the process had to say."""
    with tempfile.TemporaryFile() as log:
        process = subprocess.Popen(command, stdout=log, stderr=log)
        try:
            yield process
        except InputError as error:
            raise InputError(f'{error.message}; {name} says: {_tail(log)}') from None
        finally:
            process.terminate()
            process.wait()


def _tail(log: IO[bytes]) -> str:
    log.seek(0)
    return ' | '.join(log.read().decode(errors='replace').split('\n')[-5:]).strip(' |') or 'nothing'


def await_ready(operator: Operator) -> None:
    """Wait for the node to have loaded its bone, or pass on why it could not."""
    from diagnostic_msgs.msg import DiagnosticStatus

    status = operator.hear(DiagnosticStatus, '~/status', accept=lambda status: told(status)['state'] == 'idle'
                           or told(status)['reason'] != '')
    if told(status)['reason'] != '':
        raise InputError(status.message)
    operator.patience = PATIENCE


def told(status: DiagnosticStatus) -> dict[str, str]:
    """Return the values of a status by name."""
    return {pair.key: pair.value for pair in status.values}


def touch_landmarks(operator: Operator, bag: Path, truth: Truth, say: Narrator) -> None:
    """Capture each landmark as soon as the tip rests there."""
    with running(player_command(bag, '/probe/landmarks'), 'the player'):
        captured = 0

        def all_captured() -> bool:
            nonlocal captured
            answer = operator.ask('capture_landmark')
            if answer.success:
                captured += 1
                say(answer.message)
            return captured == len(truth.landmark_names)
        operator.spin_until(all_captured, 'the tip did not rest at all landmarks')


def drag(operator: Operator, bag: Path, say: Narrator) -> None:
    """Collect what the probe touches."""
    say(operator.collect(True).message)
    with running(player_command(bag, '/probe/tip'), 'the player') as player:
        player.wait()
    say(operator.collect(False).message)


def show(model: Path, truth: Truth, say: Narrator) -> None:
    """Receive the pose as a late joiner does, and say how good it is and what the node saw."""
    from diagnostic_msgs.msg import DiagnosticStatus
    from geometry_msgs.msg import PoseStamped

    from gsdf_registration.cli.summary import true_error
    from gsdf_registration.model import load_model
    from gsdf_registration.node.operator import Operator
    from msg_adapters.ros import pose_from

    with Operator() as late_joiner:
        _, T, frame_id = pose_from(late_joiner.hear(PoseStamped, '~/bone_pose'))
        status = late_joiner.hear(DiagnosticStatus, '~/status')
    say('a client that joined after all this has received the pose:')
    for row in T[:3]:
        print('   ' + ''.join(f'{value:10.5f}' for value in row))
    print(f'  T_{frame_id}_bone, metres')
    result = RegistrationResult(Reason.CONVERGED, status.message, T)
    print('  ' + true_error(result, load_model(str(model), truth.model_unit), truth.T_tracker_bone))
    print(f'  the node saw   {what_was_seen(told(status))}')


def what_was_seen(values: dict[str, str]) -> str:
    """Return in words what the node's status says of the points."""
    refused = [f'{count} {key.removeprefix("rejected.").replace("_", " ")}' for key, count in values.items()
               if key.startswith('rejected.') and count != '0']
    return (f'{values["received"]} points; kept {values["kept"]} in {values["strokes"]} strokes'
            + (f'; not kept {", ".join(refused)}' if refused else '') + f'; {values["landmarks"]} landmarks')
