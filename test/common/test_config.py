# SPDX-License-Identifier: Apache-2.0
"""
Test the settings and the settings files.

``python test/common/test_config.py`` writes config/registration.yaml after a change of a setting.
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

from gsdf_registration.common.config import Config, UnmatchedPlaces, settings
from gsdf_registration.common.result import InputError, Reason
from gsdf_registration.common.settings_schema import default_value

FOLDER = Path(__file__).parents[2] / 'config'
HEAD = """\
# SPDX-License-Identifier: Apache-2.0
# All settings with their defaults. A file of your own needs only the settings that you change:
#   gsdf register ... --config my.yaml
#   ros2 launch gsdf_registration registration.launch.py config:=my.yaml
/**:
  ros__parameters:
"""


def documented_settings() -> str:
    """Return the expected content of config/registration.yaml."""
    text, section = HEAD, ''
    for name, declared in settings():
        about = declared.metadata
        if section != name.split('.')[0]:
            section = name.split('.')[0]
            text += f'    {section}:\n'
        value = yaml.safe_dump(default_value(declared), default_flow_style=True,
                               width=1000).split('\n')[0]
        unit = f' [{about["unit"]}]' if about['unit'] else ''
        choices = f' ({", ".join(about["choices"])})' if about['choices'] else ''
        text += f'      # {about["description"]}{choices}{unit}\n'
        text += f'      {name.split(".")[1]}: {value}\n'
    return text


def test_settings_file_lists_all_settings_with_default_and_description() -> None:
    assert (FOLDER / 'registration.yaml').read_text() == documented_settings(), (
        'run python test/common/test_config.py to write the file')


@pytest.mark.parametrize('file', sorted(FOLDER.glob('*.yaml')), ids=lambda file: file.stem)
def test_loads_installed_settings_files(file: Path) -> None:
    config = Config.from_nested(yaml.safe_load(file.read_text()))
    if file.stem == 'registration':
        assert config == Config()
    else:
        assert config != Config()


@pytest.mark.parametrize('file', sorted(FOLDER.glob('*.yaml')), ids=lambda file: file.stem)
def test_values_in_installed_files_have_the_ros_parameter_type(file: Path) -> None:
    defaults = Config().flat()
    for section, keys in yaml.safe_load(file.read_text())['/**']['ros__parameters'].items():
        for key, value in keys.items():
            assert type(value) is type(defaults[f'{section}.{key}']), f'{section}.{key}: {value!r}'


def test_every_setting_has_a_description_and_a_valid_default() -> None:
    for name, declared in settings():
        about = declared.metadata
        assert about['description'], name
        assert (about['low'] is None) == (about['high'] is None), name
        if type(default_value(declared)) in (int, float):
            assert about['low'] <= default_value(declared) <= about['high'], name


def test_flat_and_from_flat_are_inverse() -> None:
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
def test_from_nested_skips_node_name_and_ros_parameters(wrap: Any) -> None:
    nested = wrap({'gate': {'max_speed': 0.5}})
    assert Config.from_nested(nested) == Config.from_flat({'gate.max_speed': 0.5})


@pytest.mark.parametrize(('values', 'sentence'), [
    ({'gate.max_sped': 0.5}, 'unknown parameter "gate.max_sped"; did you mean gate.max_speed?'),
    ({'nothing': 0.5}, 'unknown parameter "nothing"; config/registration.yaml lists'),
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
    ({'targets.names': ['a', 'a'], 'targets.positions': 6 * [0.0]}, 'has a duplicate name'),
    ({'landmarks.names': ['a'], 'landmarks.positions': 3 * [0.0],
      'landmarks.sigmas': [0.002, 0.002]}, 'landmarks.names: 1 numbers, not 2'),
    ({'landmarks.names': ['a'], 'landmarks.positions': 3 * [0.0],
      'landmarks.sigmas': [2.0]}, 'landmarks.sigmas must be from 0'),
    ({'landmarks.names': ['a'], 'landmarks.positions': 3 * [0.0],
      'landmarks.sigmas': [-0.001]}, 'landmarks.sigmas must be from 0'),
    ({'guidance.near': ['a']}, 'neither a landmark nor a target'),
    ({'tf.rate': 1e-300}, 'tf.rate must be 0 or at least 0.01 Hz'),
    ({'gate.max_speed': 10**400}, 'gate.max_speed must be a finite number'),
    ({'x' * 5000: 1}, r'unknown parameter "x{100}\.\.\."'),
])
def test_rejects_invalid_values_with_a_message(values: dict[str, Any], sentence: str) -> None:
    with pytest.raises(InputError, match=sentence) as refusal:
        Config.from_flat(values)
    assert refusal.value.reason is Reason.BAD_INPUT


def test_says_which_of_two_settings_is_waited_for() -> None:
    names, positions = {'landmarks.names': ['a', 'b', 'c']}, {'landmarks.positions': 9 * [0.0]}
    with pytest.raises(UnmatchedPlaces) as refusal:
        Config.from_flat(names)
    assert refusal.value.parameters == ('landmarks.names', 'landmarks.positions')
    assert refusal.value.waiting == ('landmarks.names has 3 entries, landmarks.positions has 0 '
                                     'numbers; waiting for the other')
    assert Config.from_flat(names | positions).landmarks.names == ['a', 'b', 'c']


def test_converts_whole_numbers_to_the_declared_type() -> None:
    config = Config.from_flat({'gate.max_speed': 2, 'limits.min_points': 50.0})
    assert type(config.gate.max_speed) is float
    assert type(config.limits.min_points) is int


@hypothesis_settings(deadline=None, max_examples=50)
@given(st.floats(1e-4, 0.01), st.integers(6, 100_000), st.lists(st.text(max_size=5), max_size=3))
def test_values_survive_a_yaml_file(voxel: float, points: int, topics: list[str]) -> None:
    config = Config.from_flat({'model.voxel_size': voxel, 'limits.min_points': points,
                               'probe.topics': topics})
    nested: dict[str, dict[str, Any]] = {}
    for name, value in config.flat().items():
        section, key = name.split('.')
        nested.setdefault(section, {})[key] = value
    assert Config.from_nested(yaml.safe_load(yaml.safe_dump(nested))) == config


def test_the_shaft_points_from_the_tip_to_the_handle() -> None:
    tip = [0.0, 0.01, -0.15]
    for shaft in ([], [0.0, 0.0, 2.0], [1.0, 0.0, 0.0]):
        assert Config.from_flat({'probe.tip': tip, 'probe.shaft': shaft}).probe.shaft == shaft
    with pytest.raises(InputError, match='probe.shaft .* points from the handle to the tip'):
        Config.from_flat({'probe.tip': tip, 'probe.shaft': [0.0, 0.0, -1.0]})
    origin_at_tip = {'probe.tip': [0.0, 0.0, 0.0], 'probe.shaft': [0.0, 0.0, -1.0]}
    assert Config.from_flat(origin_at_tip).probe.shaft


def test_the_file_named_in_an_error_exists() -> None:
    with pytest.raises(InputError) as refusal:
        Config.from_flat({'nothing.like_it': 1})
    path = re.findall(r'config/\S+\.yaml', refusal.value.message)[0]
    assert (FOLDER.parent / path).is_file()


if __name__ == '__main__':
    (FOLDER / 'registration.yaml').write_text(documented_settings())
