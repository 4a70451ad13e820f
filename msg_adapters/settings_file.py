# SPDX-License-Identifier: Apache-2.0
"""Read settings from a YAML file, as in config/registration.yaml."""

from __future__ import annotations

import yaml

from gsdf_registration.common.config import Config
from gsdf_registration.common.result import InputError
from msg_adapters.files import read_text


def read_config(path: str | None) -> Config:
    """
    Return the settings of a YAML file, or the defaults if there is no file.

    Raises
    ------
    InputError
        If the file cannot be read, is not valid YAML, or contains an unknown or invalid setting.

    """
    if path is None:
        return Config()
    try:
        values = yaml.safe_load(read_text(path))
    except yaml.YAMLError as error:
        mark = getattr(error, 'problem_mark', None)
        where = '' if mark is None else f', line {mark.line + 1}'
        raise InputError(f'{path}{where}: this is not valid YAML') from None
    if not isinstance(values, dict):
        raise InputError(f'{path} contains no settings; give sections with names and values, as in '
                         'config/registration.yaml')
    try:
        return Config.from_nested(values)
    except InputError as error:
        raise InputError(f'{path}: {error.message}') from None
