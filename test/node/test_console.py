# SPDX-License-Identifier: Apache-2.0
"""The command of the console refuses what would show the page to everybody."""

from __future__ import annotations

import pytest

from gsdf_registration.node.console import main


def test_other_machines_need_a_token(capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip('viser')
    assert main(['--host', '0.0.0.0']) == 2
    assert capsys.readouterr().err == ('registration_console: --host 0.0.0.0 shows the page to '
                                       'other machines: give a --token too\n')


def test_says_what_to_install_without_viser(monkeypatch: pytest.MonkeyPatch,
                                            capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr('importlib.util.find_spec', lambda name: None)
    assert main([]) == 2
    assert "pip install 'gsdf_registration[console]'" in capsys.readouterr().err
