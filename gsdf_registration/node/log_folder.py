# SPDX-License-Identifier: Apache-2.0
"""The folder of the log files of ROS, without which no ROS node starts."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from gsdf_registration.common.user_cache import is_writable, temporary_cache


def choose_log_folder() -> None:
    """
    Set ``ROS_LOG_DIR`` to a temporary folder if ROS cannot write to its own.

    To be called before `rclpy.init`, which fails without a folder to log to.
    """
    chosen = _log_folder()
    if chosen is not None and is_writable(chosen):
        return
    folder = temporary_cache() / 'log'
    if is_writable(folder.parent, private=True) and is_writable(folder, private=True):
        os.environ['ROS_LOG_DIR'] = str(folder)
        print(f'registration_node: the log is in {folder}, because {chosen or "~/.ros/log"} cannot '
              'be written; set ROS_LOG_DIR to a folder that lasts', file=sys.stderr)


def _log_folder() -> Path | None:
    """Return the folder that rcl_logging uses; None if this user has no home directory."""
    try:
        home = os.environ.get('ROS_HOME') or '~/.ros'
        return Path(os.environ.get('ROS_LOG_DIR') or f'{home}/log').expanduser()
    except RuntimeError:
        return None
