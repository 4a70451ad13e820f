# SPDX-License-Identifier: Apache-2.0
"""Which recordings patterns, folders and tables of cases name."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from gsdf_registration.cli.archive import Case, find_bags, read_cases
from gsdf_registration.common.result import InputError

METADATA = 'rosbag2_bagfile_information: {relative_file_paths: [part_0.mcap, part_1.mcap]}\n'


@pytest.fixture(autouse=True)
def archive(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Work in a folder with an archive of several kinds of recordings."""
    monkeypatch.chdir(tmp_path)
    for name in ('archive/b/split/part_0.mcap', 'archive/b/split/part_1.mcap',
                 'archive/b/killed/killed_0.mcap', 'archive/b/killed/killed_1.mcap',
                 'archive/a/one.mcap', 'archive/a/two.mcap.zstd', 'archive/a/ros1.bag',
                 'archive/a/one.yaml', 'archive/a/notes.txt', 'elsewhere/bone.ply'):
        Path(name).parent.mkdir(parents=True, exist_ok=True)
        Path(name).touch()
    Path('archive/b/split/metadata.yaml').write_text(METADATA)


def test_a_folder_is_expanded_in_a_stable_order(capsys: pytest.CaptureFixture[str]) -> None:
    assert find_bags(['archive']) == [
        'archive/a/one.mcap', 'archive/a/ros1.bag', 'archive/a/two.mcap.zstd',
        'archive/b/killed', 'archive/b/split']
    # the ground truth belongs to a recording, the note does not
    assert capsys.readouterr().err == ('note: archive: 1 file left out, not a recording: '
                                       'notes.txt\n')


def test_parts_of_a_recording_stand_for_the_recording() -> None:
    assert find_bags(['archive/**/*.mcap']) == ['archive/a/one.mcap', 'archive/b/killed',
                                                'archive/b/split']
    # but a file that is named itself, or that the metadata does not name, is a recording
    Path('archive/b/split/other_0.mcap').touch()
    assert find_bags(['archive/b/split/*.mcap', 'archive/b/split/part_0.mcap']) == [
        'archive/b/split', 'archive/b/split/other_0.mcap', 'archive/b/split/part_0.mcap']


def test_words_keep_their_order_and_nothing_is_named_twice() -> None:
    assert find_bags(['archive/b/*', 'archive/a/one.mcap', 'archive/*/*.mcap']) == [
        'archive/b/killed', 'archive/b/split', 'archive/a/one.mcap']
    assert find_bags(['archive/b/split', 'nowhere']) == ['archive/b/split', 'nowhere']


def test_a_recording_without_a_storage_file_is_named() -> None:
    os.makedirs('archive/c/lost')
    Path('archive/c/lost/metadata.yaml').write_text(METADATA)
    assert find_bags(['archive/c']) == ['archive/c/lost']


@pytest.mark.parametrize('word', ['archive/**/*.db3', 'else*/*'])
def test_a_pattern_without_a_recording_is_refused(word: str) -> None:
    with pytest.raises(InputError, match='there is no recording'):
        find_bags([word])


def test_cases_are_relative_to_their_table() -> None:
    Path('archive/cases.csv').write_text(
        'Bag;model;label;landmarks\na/one.mcap;../elsewhere/bone.ply;left knee;\n'
        'b/*;;;a/one.yaml\n')
    assert read_cases('archive/cases.csv') == [
        Case('archive/a/one.mcap', 'archive/../elsewhere/bone.ply', None, None, 'left knee'),
        Case('archive/b/killed', None, 'archive/a/one.yaml'),
        Case('archive/b/split', None, 'archive/a/one.yaml')]


@pytest.mark.parametrize('text, says', [
    ('bag,modle\n', 'line 1: has the unknown column "modle"'),
    ('model,label\n', 'line 1: has no column "bag"'),
    ('bag,model\na/one.mcap,\na/one.mcap,none.ply\n',
     'line 3: the model archive/none.ply does not exist'),
    ('bag,label\n,x\n', 'line 2: the column "bag" is empty'),
    ('bag\na/none.mcap\n', 'line 2: the bag archive/a/none.mcap does not exist'),
    ('bag\n', 'has no cases')])
def test_a_table_that_is_wrong_is_refused_with_the_line(text: str, says: str) -> None:
    Path('archive/cases.csv').write_text(text)
    with pytest.raises(InputError) as refusal:
        read_cases('archive/cases.csv')
    assert says in refusal.value.message and 'archive/cases.csv' in refusal.value.message
