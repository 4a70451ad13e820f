# SPDX-License-Identifier: Apache-2.0
"""``gsdf pivot``: find the tip of a tool from poses recorded while it was turned in a divot."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gsdf_registration.cli import outputs
from gsdf_registration.common.command_line import example

if TYPE_CHECKING:
    from gsdf_registration.common.rigid import Array
    from gsdf_registration.tracking.pivot import FixedPoint
    from msg_adapters.tool_poses import ToolPoses

SCHEMA = 'gsdf-pivot/1'
NEAREST = 0.01      # m; no tracker sees a tool that is always so near to its origin


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        'pivot', help='find the tip of a tool from a pivot recording',
        description='Find the tip of a tool in the frame of the tool, from poses recorded while '
        'the tip was kept in a divot and the tool was tilted to all sides. Wrong readings are left '
        'out; if the tip slipped, only the longest part is used. The tip is rejected if its '
        'expected error (95 %) exceeds 1 mm.',
        **example('gsdf pivot pivot_bag --topic /probe/measured_cp -o tip.yaml',
                  'gsdf pivot pivot.csv --unit mm --tool Probe'))
    parser.add_argument('recording', metavar='BAG|CSV',
                        help='a bag; a CSV with the header tx,ty,tz,qx,qy,qz,qw; or an NDI tracker '
                        'CSV')
    parser.add_argument('--unit', choices=('mm', 'm'),
                        help='unit of the lengths in a CSV (default: m for a bag, mm for an NDI '
                        'tracker CSV)')
    parser.add_argument('--tool', metavar='NAME',
                        help='part of the port label, if an NDI tracker CSV has several tools')
    parser.add_argument('--topic', metavar='T',
                        help='topic of the poses, if a bag has several (PoseStamped, '
                        'PoseWithCovarianceStamped or TransformStamped)')
    parser.add_argument('-o', '--output', metavar='TIP.yaml',
                        help='write the tip as settings for --params-file of the node and --config '
                        'of gsdf; a tip that is there is kept under another name')
    parser.add_argument('--json', metavar='OUT',
                        help='write the result as JSON; - for standard output')
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Find the tip, print and write it; return 1 if it is rejected."""
    from gsdf_registration.tracking.pivot import calibrate_pivot
    from msg_adapters.tool_poses import read_tool_poses

    poses = read_tool_poses(args.recording, args.unit, tool=args.tool, topic=args.topic)
    result = _with_unit_check(calibrate_pivot(poses.T_tracker_body, poses.stamps), poses)
    kept = _write_tip(args, result, poses)
    outputs.write_json(args.json, pivot_to_json(result, poses))
    output = sys.stderr if args.json == '-' else sys.stdout
    for note in poses.notes:
        print(f'note: {note}', file=sys.stderr)
    print(result.message, file=output)
    if result.point is not None and result.centre is not None:
        print(f'tip in the tool frame:      {_millimetres(result.point)}\n'
              f'pivot in the tracker frame: {_millimetres(result.centre)}', file=output)
    if args.output is not None and result.success:
        print(f'tip written to {args.output}'
              + (f'; the tip that was there before is kept as {kept}' if kept else ''), file=output)
    left_out = ', '.join(f'{count} {cause.replace("_", " ")}'
                         for cause, count in _rejected(result, poses).items() if count)
    if left_out:
        print(f'poses left out: {left_out}', file=output)
    return 0 if result.success else 1


def _write_tip(args: argparse.Namespace, result: FixedPoint, poses: ToolPoses) -> Path | None:
    """Write the tip file if it is asked for; return where the one that was there is kept."""
    from msg_adapters.tip_file import check_tip_path, write_tip

    if args.output is None:
        return None
    check_tip_path(args.output)
    if result.point is None or result.covariance is None:
        return None
    return write_tip(args.output, result.point, result.covariance[:3, :3], result.message,
                     f'{args.recording}, {poses.name}')


def _with_unit_check(result: FixedPoint, poses: ToolPoses) -> FixedPoint:
    """Return the result, or a rejection if the lengths are in another unit than was given."""
    import numpy as np

    from gsdf_registration.tracking.pivot import (
        FixedPoint,
        PivotReason,
        calibrate_pivot,
    )
    T = poses.T_tracker_body
    distances = np.linalg.norm(T[:, :3, 3], axis=1)
    farthest = float(np.nanmax(distances, initial=0.0))
    message = ''
    if result.success and farthest < NEAREST:
        message = (f'the tool is never more than {1e3 * farthest:.1f} mm from the origin of the '
                   'tracker: the lengths are in m, use --unit m')
    elif result.reason is PivotReason.NOT_FIXED and 1e-3 * farthest >= NEAREST:
        in_mm = T.copy()
        in_mm[:, :3, 3] *= 1e-3
        if calibrate_pivot(in_mm, poses.stamps).success:
            message = ('no point of the tool stays still if the lengths are in m, but one does if '
                       'they are in mm: use --unit mm')
    if not message:
        return result
    return FixedPoint(PivotReason.WRONG_UNIT, message, used=np.zeros_like(result.used),
                      rejected=result.rejected)


def pivot_to_json(result: FixedPoint, poses: ToolPoses) -> dict[str, Any]:
    """Return the document of one calibration; every key is present, null where unknown; SI."""
    def listed(values: Array | None) -> Any:
        return None if values is None else values.tolist()

    def degrees(radians: Any) -> Any:
        import numpy as np
        return None if radians is None else np.degrees(radians).tolist()
    return {
        'schema': SCHEMA,
        'success': result.success,
        'reason': str(result.reason),
        'message': result.message,
        'tip_m': listed(result.point),
        'pivot_m': listed(result.centre),
        'covariance': None if result.covariance is None else listed(result.covariance[:3, :3]),
        'expected_error_m': result.error,
        'residual_rms_m': result.residual_rms,
        'angle_range_deg': degrees(result.angle_range),
        'angle_ranges_xyz_deg': degrees(result.angles),
        'poses': {'received': len(poses.T_tracker_body), 'used': int(result.used.sum())},
        'rejected': _rejected(result, poses),
        'tool': poses.name,
    }


def _rejected(result: FixedPoint, poses: ToolPoses) -> dict[str, int]:
    """Return the number of poses left out by cause; the causes of the reader are more precise."""
    counts = {**result.rejected, **poses.rejected}
    invalid = poses.rejected.get('not_finite', 0) + poses.rejected.get('not_unit', 0)
    # without a finite stamp
    counts['not_finite'] += result.rejected['not_finite'] - invalid
    return counts


def _millimetres(position: Array) -> str:
    return '  '.join(f'{1e3 * value:9.2f}' for value in position) + ' mm'
