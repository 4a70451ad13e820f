# SPDX-License-Identifier: Apache-2.0
"""Test reading and writing of the ground truth."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gsdf_registration.common.result import InputError
from gsdf_registration.common.rigid import exp
from msg_adapters.truth import Truth, read_truth, truth_path, write_truth

TRUTH = Truth('hip.stl', 'mm', 'tracker', exp([0.1, 0.2, 0.3, 1.0, -2.0, 3.0]), ('a', 'b'),
              np.array([[1, 2, 3], [4, 5, 6]]), np.array([[1.5, 2, 3], [4, 5, 6]]),
              {'seed': 7, 'noise': {'sigma_m': 1e-4}, 'command': 'gsdf simulate'})


def test_reads_what_was_written_bit_for_bit(tmp_path):
    write_truth(tmp_path / 'run.yaml', TRUTH)
    back = read_truth(tmp_path / 'run.yaml')
    for name in vars(TRUTH):
        np.testing.assert_array_equal(getattr(back, name), getattr(TRUTH, name))


def test_reads_a_truth_without_landmarks(tmp_path):
    write_truth(tmp_path / 'run.yaml', Truth('m.ply', 'm', 'tracker', np.eye(4)))
    assert read_truth(tmp_path / 'run.yaml').landmarks_model.shape == (0, 3)


def test_truth_path_is_beside_the_bag():
    assert truth_path('bags/run.1') == Path('bags/run.1.yaml')
    assert truth_path('bags/run.mcap') == Path('bags/run.yaml')
    assert truth_path('bags/run/') == Path('bags/run.yaml')
    assert truth_path('bags/run.1.mcap.zstd') == Path('bags/run.1.yaml')
    assert truth_path('bags/run.bag') == Path('bags/run.yaml')


@pytest.mark.parametrize('old, new, words', [
    ('schema: gsdf-truth/1', 'schema: other', 'schema'),
    ('model_unit: mm', 'model_unit: cm', 'cm'),
    ('frame_id: tracker', 'frame: tracker', 'frame_id is missing'),
    ('name: a', 'nome: a', 'name is missing'),
    ('[1.0, 2.0, 3.0]', '[1.0, 2.0]', 'damaged'),
    ('[0.0, 0.0, 0.0, 1.0]', '[0.0, 0.0, 0.0, 2.0]', 'rigid'),
    ('landmarks:', 'landmarks: [', 'YAML'),
])
def test_rejects_invalid_files(tmp_path, old, new, words):
    path = tmp_path / 'run.yaml'
    write_truth(path, TRUTH)
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    with pytest.raises(InputError, match=words):
        read_truth(path)


def test_rejects_inconsistent_values():
    with pytest.raises(ValueError, match='number'):
        Truth('m', 'mm', 'f', np.eye(4), ('a',))
    with pytest.raises(ValueError, match='rigid'):
        Truth('m', 'mm', 'f', 2 * np.eye(4))
