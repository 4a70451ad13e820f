# SPDX-License-Identifier: Apache-2.0
"""Settings files that are not valid end in one short sentence, quickly."""

from __future__ import annotations

from pathlib import Path

import pytest

from gsdf_registration.common.result import InputError
from msg_adapters.settings_file import read_config

BOMB = 'a: &a [x, x]\n' + ''.join(f'{new}: &{new} [*{old}, *{old}, *{old}, *{old}]\n'
                                  for old, new in zip('abcdefghijklmnopqrstuv',
                                                      'bcdefghijklmnopqrstuvw'))


def test_reads_a_ros_parameter_file(tmp_path: Path) -> None:
    file = tmp_path / 'femur.yaml'
    file.write_text('/femur/registration:\n  ros__parameters:\n    use_sim_time: true\n'
                    '    gate: {max_speed: 0.5}\n')
    assert read_config(str(file)).gate.max_speed == 0.5


@pytest.mark.parametrize('text, sentence', [
    (BOMB, 'line 2: this is not valid YAML: aliases such as *name are not supported'),
    ('gate: &g\n  max_speed: *g\n', 'line 2: this is not valid YAML: aliases'),
    ('[' * 20_000, 'the sections are nested too deeply'),
    ('{a: ' * 2000 + '1' + '}' * 2000, 'the sections are nested too deeply'),
    ('gate: {max_speed: ' + '9' * 5000 + '}', 'a number with thousands of digits'),
    ('gate: {max_speed: ' + '9' * 400 + '}', 'gate.max_speed must be a finite number, not 999'),
    ('limits: {min_points: 0x' + 'f' * 9000 + '}', 'limits.min_points must be a whole number'),
    ('gate: {max_speed: 2024-13-45}', 'an invalid date'),
    ('solver: {method: ' + 'x' * 5000 + '}', 'solver.method must be one of mixture, paper'),
    ('a: b\n' * 250_000, 'a settings file has at most 1000000 characters'),
    ('[a, b]', 'contains no settings'),
], ids=['alias bomb', 'self-reference', 'deep list', 'deep sections', 'digits', 'large', 'hex',
        'date', 'long', 'large file', 'list'])
def test_rejects_what_it_cannot_read(tmp_path: Path, text: str, sentence: str) -> None:
    file = tmp_path / 'settings.yaml'
    file.write_text(text)
    with pytest.raises(InputError) as refusal:
        read_config(str(file))
    assert sentence in refusal.value.message
    assert len(refusal.value.message) < 300 + len(str(file))
