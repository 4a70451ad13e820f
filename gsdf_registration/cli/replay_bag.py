# SPDX-License-Identifier: Apache-2.0
"""Register one recording: its result, and what was noticed while it was read."""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gsdf_registration.cli import inputs, landmark_files, outputs
from gsdf_registration.cli.pose_outputs import PoseOutputs
from gsdf_registration.common.result import InputError, Refusal, RegistrationResult

if TYPE_CHECKING:
    from gsdf_registration.cli.summary import TrueError
    from gsdf_registration.common.config import Config
    from gsdf_registration.common.landmarks import Landmarks
    from gsdf_registration.common.rigid import Array
    from gsdf_registration.field import Field
    from gsdf_registration.session import Session
    from gsdf_registration.session.operator_replay import Settle
    from msg_adapters.recording import Recording
    from msg_adapters.truth import Truth


@dataclass(frozen=True)
class Outcome:
    """
    The outcome for one recording.

    status : exit code
    document : JSON
    text : to print, or the sentence of an error
    notes : sentences on the recording
    error : from the ground truth; None: not known
    places : (n, 3) float, m, bone frame, where the pose must be accurate; None without a pose
    required_error : float, m, the largest error at these places; None: not known
    """

    status: int
    document: dict[str, Any]
    text: str
    notes: tuple[str, ...] = ()
    error: TrueError | None = None
    places: Array | None = None
    required_error: float | None = None


@dataclass(frozen=True)
class _Inputs:
    """A recording with what is used to register it."""

    recording: Recording
    config: Config              # that of the recorded node, changed by the options
    settle: Settle              # the settings in place of those of a recorded node
    landmarks: Landmarks | None
    T_tracker_bone: Array | None
    axes: landmark_files.Axes
    field: Field | Refusal      # a refusal if the model is not as large as a bone
    truth: Truth | None
    load_s: float               # time to load the model
    started: float              # s, when the recording was opened


@dataclass(frozen=True)
class _Registered:
    """What came out of it; without a bone of a valid size there is no session."""

    result: RegistrationResult
    notes: tuple[str, ...]
    frame_id: str
    points: Array               # (n, 3) m
    bone: Field | None = None
    session: Session | None = None


def replay_bag(bag: str, args: argparse.Namespace, threads: int = 0,
               bag_sha256: str = '') -> Outcome:
    """
    Register one recording; unreadable input is an outcome, too.

    Parameters
    ----------
    bag : path
    args : the options of ``gsdf replay`` for this recording; ``report`` is the file of the report
    threads : of the search if the settings do not say; 0: one per core
    bag_sha256 : of the bag, if it is known

    Raises
    ------
    InputError
        If the settings are not valid.

    """
    from gsdf_registration.cli.result_json import result_to_json
    from gsdf_registration.cli.summary import summary, true_error
    from gsdf_registration.common.rigid import displacement
    from msg_adapters.files import sha256_of

    config = inputs.effective_config(args)
    try:
        given = _read_inputs(bag, args, config)
    except InputError as error:
        refused = RegistrationResult.refused(error.reason, error.message)
        return Outcome(2, result_to_json(refused, config), error.message)
    opened = time.perf_counter()
    found = _register(given, threads, args.mcap)
    result, bone, places = found.result, found.bone, _places(found, given.config)
    true = required_error = None
    error_text = ''
    if bone and given.truth and found.frame_id in ('', given.truth.frame_id):
        T_true = given.truth.T_tracker_bone
        true = true_error(result, bone, T_true)
        error_text = str(true) if true else 'none, there is no pose'
        if result.T_tracker_bone is not None and places is not None:
            required_error = float(displacement(result.T_tracker_bone, T_true, places).max())
    document = result_to_json(
        result, given.config, frame_id=found.frame_id,
        points_sha256=bag_sha256 or sha256_of(bag),
        model_sha256=bone.bone_sha256 if bone else None,
        recording={'complete': given.recording.complete, 'notes': found.notes},
        load_s=given.load_s + opened - given.started,
        total_s=given.load_s + time.perf_counter() - given.started)
    PoseOutputs.of(args, given.axes).write(result, given.config, found.frame_id, found.points,
                                           given.landmarks)
    if args.report is not None:
        _write_report(bag, args, given, found, document, error_text)
    rows = [('true error', error_text)] if error_text else []
    return Outcome(0 if result.success else 1, document, summary(result, found.frame_id, rows),
                   found.notes, true, places, required_error)


def _read_inputs(bag: str, args: argparse.Namespace, config: Config) -> _Inputs:
    """Read the model, the recording, and the files of the options; raise `InputError`."""
    from msg_adapters.truth import read_truth, truth_path
    axes = landmark_files.axes_of(args, config)
    landmarks = landmark_files.read_landmark_files(args, config, args.unit)
    T_tracker_bone = inputs.read_initial(args.initial)
    field, load_s = inputs.timed_field(config)
    if not isinstance(field, Refusal):
        landmark_files.check_axes(landmarks, field.for_tip(config.probe.tip_radius), axes)
    settle = partial(inputs.effective_config, args)
    started = time.perf_counter()
    recording = inputs.read_recording(bag, config, args.topic,
                                      '' if args.events == 'none' else args.events)
    truth = read_truth(truth_path(bag)) if truth_path(bag).is_file() else None
    return _Inputs(recording, inputs.config_of(recording, config, settle), settle, landmarks,
                   T_tracker_bone, axes, field, truth, load_s, started)


def _register(given: _Inputs, threads: int, mcap: str | None) -> _Registered:
    from gsdf_registration.cli.session_bag import recorded
    from gsdf_registration.common.formatting import format_count
    from gsdf_registration.session.replay import replay_events

    def settle(base: Config) -> Config:
        config = given.settle(base)
        return config if config.search.threads or not threads else config.replaced(
            {'search.threads': threads})
    notes = tuple(given.recording.notes)
    if isinstance(given.field, Refusal):
        refused = RegistrationResult.refused(given.field.reason, given.field.message)
        found = _Registered(refused, notes, '', given.recording.positions)
    else:
        bone = given.field.for_tip(given.config.probe.tip_radius)
        with recorded(mcap, given.recording, bone) as watch:
            replayed = replay_events(given.recording, bone, settle, given.landmarks,
                                     given.T_tracker_bone, watch)
        session = replayed.session
        found = _Registered(replayed.result, (*notes, *replayed.notes),
                            session.status().frame_id or '', session.points().positions, bone,
                            session)
    if not found.notes:
        return found
    remark = ('the recording is not complete' if not given.recording.complete
              else f'see the {format_count(len(found.notes), "note")} on the recording')
    return replace(found, result=replace(found.result,
                                         message=f'{found.result.message}; {remark}'))


def _places(found: _Registered, config: Config) -> Array | None:
    """Return the places (n, 3), m, bone frame, where an accepted pose must be accurate."""
    from gsdf_registration.registration.required_places import required_places
    if not found.result.success or found.session is None or found.bone is None:
        return None
    registered = found.session.registered_points()
    points = found.points if registered is None else registered.positions
    return required_places(found.result, points, found.bone, config)


def _write_report(bag: str, args: argparse.Namespace, given: _Inputs, found: _Registered,
                  document: dict[str, Any], error_text: str) -> None:
    from gsdf_registration.cli.session_report import content_of, content_of_refusal
    model, result, config = Path(given.config.model.path), found.result, given.config
    remarks = {f'note {number}': note for number, note in enumerate(found.notes, 1)}
    about = outputs.about_inputs(str(model), bag, document)
    complete = 'complete' if given.recording.complete else 'NOT complete'
    common: dict[str, Any] = {
        'title': f'{model.name} from {Path(bag).name}', 'case': args.case,
        'axes': given.axes.model,
        'about': {**about, 'recording': complete, **remarks,
                  'true error': error_text or 'not known'}}
    if found.bone is None or found.session is None:
        content = content_of_refusal(result, config, found.points, **common)
    else:
        content = content_of(found.session, result, config, found.bone,
                             landmarks=given.landmarks, **common)
    outputs.write_report(args.report, content)
