# SPDX-License-Identifier: Apache-2.0
"""``gsdf view``: the page of the operator's console for recordings, saved sessions and results."""

from __future__ import annotations

import argparse
import os
import sys
import threading
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gsdf_registration.cli import inputs, landmark_files, options
from gsdf_registration.common.command_line import example, positive_number, three_numbers
from gsdf_registration.common.result import InputError, Refusal

if TYPE_CHECKING:
    from gsdf_registration.common.config import Config
    from gsdf_registration.field import Field
    from gsdf_registration.visualization.console_page import ConsolePage


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        'view', help='look at a recording, a saved session or a result in a browser',
        description="Serve the page of the operator's console without ROS. A recording is played "
        'through the session of the node, with a time line; a saved session (.json) or a result '
        '(--json of register and replay) is shown as it is. It needs the extra "console".',
        **example('gsdf view bags/hip_optical --model bags/hip.ply'))
    parser.add_argument('input', metavar='BAG|SESSION|JSON',
                        help='recording as for gsdf replay, saved session, or result')
    parser.add_argument('--model', required=True, metavar='MODEL', help=options.MODEL_HELP)
    parser.add_argument('--port', type=positive_number, default=8080, metavar='N',
                        help='port of the page, which only this machine can open (default: 8080)')
    parser.add_argument('--unit', choices=('mm', 'm'), default='m',
                        help='unit of --tip and --tip-radius (default: m)')
    parser.add_argument('--topic', action='append', metavar='T',
                        help='topic of the probe; may be repeated')
    parser.add_argument('--tip', type=three_numbers, metavar='X,Y,Z',
                        help='position of the tip in the frame of the tool (default: probe.tip)')
    parser.add_argument('--tip-radius', type=float, metavar='R',
                        help='radius of the ball at the end of the probe (default: '
                        'probe.tip_radius)')
    options.add_start_options(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Serve the page until Ctrl-C."""
    from gsdf_registration.visualization.web_access import require_viser
    require_viser()
    config = inputs.effective_config(args)
    path = Path(args.input)
    document = _read_json(path) if path.suffix.lower() == '.json' else None
    inputs.prepare_kernels(config)
    field = inputs.field_or_refusal(config)
    if isinstance(field, Refusal):
        raise InputError(field.message)
    try:
        if document is None:
            _play(args, config, field)
        elif 'T_tracker_bone' in document:
            _show_result(args, config, field, document)
        else:
            _show_session(args, config, field)
    except KeyboardInterrupt:
        pass
    return 0


def _read_json(path: Path) -> dict[str, Any]:
    from msg_adapters.files import read_json
    document = read_json(path)
    if not isinstance(document, dict):
        raise InputError(f'{path} is neither a saved session nor a result')
    return document


def _serve(args: argparse.Namespace, config: Config, **given: Any) -> ConsolePage:
    """Serve a page and print its address."""
    from gsdf_registration.visualization.console_page import ConsolePage
    from gsdf_registration.visualization.console_panel import Limits
    from gsdf_registration.visualization.console_scene import LandmarkPlaces
    page = ConsolePage(port=args.port, ras=landmark_files.axes_of(args, config).model == 'ras',
                       **given)
    limits, flat = config.limits, config.landmarks.positions
    places = tuple((flat[k], flat[k + 1], flat[k + 2]) for k in range(0, len(flat), 3))
    page.show_settings(Limits(limits.max_sigma, limits.max_error, limits.verification),
                       LandmarkPlaces(tuple(config.landmarks.names), places))
    print(f'open http://127.0.0.1:{page.port}; Ctrl-C ends', flush=True)
    return page


def _play(args: argparse.Namespace, config: Config, field: Field) -> None:
    """Play a recording."""
    from gsdf_registration.cli.playback import Playback
    recording = inputs.read_recording(args.input, config, args.topic)
    if recording.stamps is None or not len(recording.stamps):
        raise InputError(f'{args.input} has no points with stamps, so it cannot be played')
    for note in recording.notes:
        print(f'note: {args.input}: {note}')
    playback = Playback(recording, field, partial(inputs.effective_config, args))
    page = _serve(args, config, run=lambda _: playback.register(), actions=('register',))
    try:
        playback.run(page, page.add_timeline(playback.duration))
    finally:
        page.stop()
        sys.stdout.flush()
        os._exit(0)     # a search that still runs must not start threads while Python ends


def _show_session(args: argparse.Namespace, config: Config, field: Field) -> None:
    """Show a saved session."""
    from gsdf_registration.cli.playback import show_session
    from gsdf_registration.live import LiveStatus
    from gsdf_registration.session import Session
    from gsdf_registration.session.status_values import status_values
    from gsdf_registration.visualization.marker_scene import MarkerScene
    from msg_adapters.session_file import read_session
    session = Session(config, field)
    session.restore(read_session(args.input))
    status = session.status()
    page = _serve(args, config, actions=())
    show_session(page, MarkerScene(), session, field)
    page.show_status(status_values(status, LiveStatus()), status.message)
    _wait(page)


def _show_result(args: argparse.Namespace, config: Config, field: Field,
                 document: dict[str, Any]) -> None:
    """Show the pose of a result; it has no points."""
    import numpy as np

    from gsdf_registration.visualization.marker_scene import MarkerScene
    page, scene = _serve(args, config, actions=()), MarkerScene()
    values = {'state': 'registered' if document.get('success') else 'refused',
              'grade': document.get('grade') or ''}
    points = document.get('points') or {}
    values |= {'received': str(points.get('received', 0)), 'kept': str(points.get('used', 0))}
    zone = document.get('zone') or {}
    values |= {f'zone.{name}': f'{value:.6f}' for name, value in zone.items()
               if isinstance(value, float)}
    empty = np.zeros(0)
    if document['T_tracker_bone'] is None or document.get('covariance') is None:
        page.show_markers(scene.bone(field))
    else:
        page.show_markers(scene.pose(
            field, config.limits, np.array(document['T_tracker_bone']),
            np.array(document['covariance']), np.zeros((0, 3)), empty, empty, ()))
    page.show_status(values, document.get('message') or '')
    _wait(page)


def _wait(page: ConsolePage) -> None:
    """Serve the page until Ctrl-C."""
    page.show_tracker(None)
    try:
        threading.Event().wait()
    finally:
        page.stop()
