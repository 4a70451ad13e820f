# SPDX-License-Identifier: Apache-2.0
"""
The settings, and the files that list them.

``python test/test_config.py`` writes config/registration.yaml anew after a setting was changed.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from gsdf_registration.common.config import Config, settings
from gsdf_registration.common.result import InputError, Reason
from gsdf_registration.common.settings_schema import default_of

FOLDER = Path(__file__).parents[2] / 'config'
HEAD = """\
# SPDX-License-Identifier: Apache-2.0
# Every setting with its default. You need none of this to run: give a file of what you change,
#   gsdf register ... --config my.yaml
#   ros2 launch gsdf_registration registration.launch.py config:=my.yaml
/**:
  ros__parameters:
"""


def documented_settings() -> str:
    """Return what config/registration.yaml must be."""
    text, section = HEAD, ''
    for name, setting in settings():
        about = setting.metadata
        if section != name.split('.')[0]:
            section = name.split('.')[0]
            text += f'    {section}:\n'
        value = yaml.safe_dump(default_of(setting), default_flow_style=True,
                               width=1000).split('\n')[0]
        unit = f' [{about["unit"]}]' if about['unit'] else ''
        choices = f' ({", ".join(about["choices"])})' if about['choices'] else ''
        text += f'      # {about["description"]}{choices}{unit}\n'
        text += f'      {name.split(".")[1]}: {value}\n'
    return text


def test_the_settings_file_lists_every_setting_with_its_default_and_description() -> None:
    assert (FOLDER / 'registration.yaml').read_text() == documented_settings(), (
        'run python test/test_config.py to write it anew')


@pytest.mark.parametrize('file', sorted(FOLDER.glob('*.yaml')), ids=lambda file: file.stem)
def test_shipped_files_load(file: Path) -> None:
    config = Config.from_nested(yaml.safe_load(file.read_text()))
    if file.stem == 'registration':
        assert config == Config()
    else:
        assert config != Config()


@pytest.mark.parametrize('file', sorted(FOLDER.glob('*.yaml')), ids=lambda file: file.stem)
def test_numbers_in_shipped_files_have_the_type_ros_asks_for(file: Path) -> None:
    defaults = Config().flat()
    for section, keys in yaml.safe_load(file.read_text())['/**']['ros__parameters'].items():
        for key, value in keys.items():
            assert type(value) is type(defaults[f'{section}.{key}']), f'{section}.{key}: {value!r}'


def test_every_setting_tells_what_it_is() -> None:
    for name, setting in settings():
        about = setting.metadata
        assert about['description'], name
        assert (about['low'] is None) == (about['high'] is None), name
        if type(default_of(setting)) in (int, float):
            assert about['low'] <= default_of(setting) <= about['high'], name


def test_flat_and_back() -> None:
    changed = Config.from_flat({'gate.max_speed': 0.5, 'probe.topics': ['/a', '/b']})
    assert changed.gate.max_speed == 0.5
    assert changed.probe.topics == ['/a', '/b']
    assert Config.from_flat(changed.flat()) == changed
    assert Config.from_flat({}) == Config()


@pytest.mark.parametrize('wrap', [
    lambda sections: sections,
    lambda sections: {'ros__parameters': sections},
    lambda sections: {'/**': {'ros__parameters': sections}},
    lambda sections: {'registration': {'ros__parameters': sections}},
])
def test_a_parameter_file_may_carry_a_node_name(wrap: Any) -> None:
    nested = wrap({'gate': {'max_speed': 0.5}})
    assert Config.from_nested(nested) == Config.from_flat({'gate.max_speed': 0.5})


@pytest.mark.parametrize(('values', 'sentence'), [
    ({'gate.max_sped': 0.5}, 'unknown parameter "gate.max_sped"; did you mean gate.max_speed?'),
    ({'nothing': 0.5}, 'unknown parameter "nothing"; known ones are listed'),
    ({'gate': 0.5}, 'unknown parameter "gate"'),
    ({'gate.max_speed': 'fast'}, 'gate.max_speed must be a finite number'),
    ({'gate.max_speed': True}, 'gate.max_speed must be a finite number'),
    ({'gate.max_speed': -1.0}, r'gate.max_speed must lie in \[0, 100\] m/s'),
    ({'gate.max_speed': float('nan')}, 'gate.max_speed must be a finite number'),
    ({'gate.max_speed': None}, 'gate.max_speed must be a finite number'),
    ({'limits.min_points': 30.5}, 'limits.min_points must be a whole number'),
    ({'limits.min_points': float('inf')}, 'limits.min_points must be a whole number'),
    ({'collect.automatic': 'yes'}, 'collect.automatic must be a bool'),
    ({'collect.automatic': 1}, 'collect.automatic must be a bool'),
    ({'model.path': 7}, 'model.path must be a str'),
    ({'model.unit': 'cm'}, 'model.unit must be one of mm, m, not "cm"'),
    ({'probe.topics': '/a'}, 'probe.topics must be a list of str'),
    ({'probe.topics': [1]}, 'probe.topics must be a list of str'),
    ({'targets.positions': ['0', '0', '0']}, 'targets.positions must be a list of float'),
    ({'targets.positions': [None, 0.0, 0.0]}, 'targets.positions must be a list of float'),
    ({'targets.positions': [True, 0.0, 0.0]}, 'targets.positions must be a list of float'),
    ({'targets.names': ['a'], 'targets.positions': [float('nan'), 0.0, 0.0]},
     'must be a list of float'),
    ({'landmarks.names': ['a']}, 'landmarks.names: 3 numbers, not 0'),
    ({'targets.positions': [0.0, 0.0]}, 'targets.names: 0 numbers, not 2'),
    ({'targets.names': ['a', 'a'], 'targets.positions': 6 * [0.0]}, 'holds a name twice'),
])
def test_what_cannot_be_used_is_refused_in_a_sentence(values: dict[str, Any],
                                                      sentence: str) -> None:
    with pytest.raises(InputError, match=sentence) as refusal:
        Config.from_flat(values)
    assert refusal.value.reason is Reason.BAD_INPUT


def test_whole_numbers_serve_where_a_fraction_may_stand() -> None:
    config = Config.from_flat({'gate.max_speed': 2, 'limits.min_points': 50.0})
    assert type(config.gate.max_speed) is float
    assert type(config.limits.min_points) is int


@hypothesis_settings(deadline=None, max_examples=50)
@given(st.floats(1e-4, 0.01), st.integers(6, 100_000), st.lists(st.text(max_size=5), max_size=3))
def test_a_file_gives_back_what_was_written(voxel: float, points: int, topics: list[str]) -> None:
    config = Config.from_flat({'model.voxel_size': voxel, 'limits.min_points': points,
                               'probe.topics': topics})
    nested: dict[str, dict[str, Any]] = {}
    for name, value in config.flat().items():
        section, key = name.split('.')
        nested.setdefault(section, {})[key] = value
    assert Config.from_nested(yaml.safe_load(yaml.safe_dump(nested))) == config


def test_the_file_that_an_error_names_is_there() -> None:
    with pytest.raises(InputError) as refusal:
        Config.from_flat({'nothing.like_it': 1})
    path = re.findall(r'config/\S+\.yaml', refusal.value.message)[0]
    assert (FOLDER.parent / path).is_file()


if __name__ == '__main__':
    (FOLDER / 'registration.yaml').write_text(documented_settings())
