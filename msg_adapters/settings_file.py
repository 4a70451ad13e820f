# SPDX-License-Identifier: Apache-2.0
"""Read settings from a YAML file, as in config/registration.yaml."""

from __future__ import annotations

from typing import Any

import yaml

from gsdf_registration.common.config import Config
from gsdf_registration.common.result import InputError
from msg_adapters.files import read_text

MAX_LENGTH = 1_000_000      # characters; a settings file has some thousands


class _Loader(yaml.SafeLoader):
    """Refuses aliases as ROS does; a few of them can stand for gigabytes, or for themselves."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.AliasEvent):
            raise yaml.MarkedYAMLError(problem='aliases such as *name are not supported',
                                       problem_mark=self.peek_event().start_mark)
        return super().compose_node(parent, index)


def read_config(path: str | None, base: Config = Config()) -> Config:   # noqa: B008 - it is frozen
    """
    Return the settings of a YAML file; those that it does not have are those of ``base``.

    Without a file they are those of ``base``.

    Raises
    ------
    InputError
        If the file cannot be read, is not valid YAML, or contains an unknown or invalid setting.

    """
    if path is None:
        return base
    values = _parse(path, read_text(path))
    if not isinstance(values, dict):
        raise InputError(f'{path} contains no settings; give sections with names and values, as in '
                         'config/registration.yaml')
    try:
        return base.merged(values)
    except InputError as error:
        raise InputError(f'{path}: {error.message}') from None


def _parse(path: str, text: str) -> Any:
    """Return the content of a YAML file; raise `InputError` if it is not valid."""
    if len(text) > MAX_LENGTH:
        raise InputError(f'{path}: a settings file has at most {MAX_LENGTH} characters, not '
                         f'{len(text)}')
    try:
        return yaml.load(text, _Loader)     # noqa: S506 - a safe loader
    except yaml.YAMLError as error:
        mark = getattr(error, 'problem_mark', None)
        where = '' if mark is None else f', line {mark.line + 1}'
        problem = getattr(error, 'problem', None) or ''
        detail = f': {problem}' if 'aliases' in problem else ''
        raise InputError(f'{path}{where}: this is not valid YAML{detail}') from None
    except RecursionError:
        raise InputError(f'{path}: the sections are nested too deeply') from None
    except (ValueError, OverflowError):     # such as a date in month 13
        raise InputError(f'{path}: a number with thousands of digits, or an invalid date, cannot '
                         'be read') from None
