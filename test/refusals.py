# SPDX-License-Identifier: Apache-2.0
"""Bad input gives one sentence: from a function, and from the command line."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from gsdf_registration.cli.main import main
from gsdf_registration.common.result import InputError


def refusal(function: Callable[..., Any], *args: Any, **options: Any) -> str:
    """Return the sentence with which a function refuses its arguments."""
    with pytest.raises(InputError) as caught:
        function(*args, **options)
    message = caught.value.message
    assert '\n' not in message and 'Traceback' not in message
    return message


def command_refusal(capsys: pytest.CaptureFixture[str], *words: object) -> str:
    """Return the line on stderr of a command that ends with exit code 2."""
    assert main([str(word) for word in words]) == 2
    error = capsys.readouterr().err
    assert error.count('\n') == 1, error
    return error
