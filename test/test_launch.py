# SPDX-License-Identifier: Apache-2.0
"""
The actions of the launch files.

There are no wheels of launch and launch_ros. The fakes below have the signatures of Jazzy, keep
their arguments, and reject arguments that the real classes do not have.
"""

from __future__ import annotations

import runpy
import sys
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / 'launch'
SETTINGS = f'{ROOT}/config/registration.yaml'


@dataclass
class Context:
    launch_configurations: dict[str, str]


@dataclass
class Configuration:
    name: str

    def perform(self, context: Context) -> str:
        return context.launch_configurations[self.name]


@dataclass
class Share:
    package: str

    def perform(self, context: Context) -> str:
        assert self.package == 'gsdf_registration'
        return str(ROOT)


@dataclass
class Joined:
    parts: list[Any]

    def perform(self, context: Context) -> str:
        return '/'.join(performed(part, context) for part in self.parts)


@dataclass
class Description:
    entities: list[Any]


@dataclass
class Argument:
    name: str
    default_value: Any = field(kw_only=True)
    description: str = field(kw_only=True)
    choices: list[str] | None = field(kw_only=True, default=None)


@dataclass(kw_only=True)
class Function:
    function: Any


@dataclass
class Group:
    actions: list[Any]


@dataclass
class Push:
    namespace: str


@dataclass
class Source:
    location: Any


@dataclass
class Include:
    source: Source
    launch_arguments: Any = field(kw_only=True)


@dataclass(kw_only=True)
class Process:
    cmd: list[str]
    name: str | None = None
    output: str = 'log'


@dataclass(kw_only=True)
class NodeAction:
    package: str
    executable: str
    name: str
    namespace: str | None = None
    parameters: list[Any] = field(default_factory=list)
    arguments: list[Any] = field(default_factory=list)
    ros_arguments: list[Any] = field(default_factory=list)
    remappings: list[tuple[str, str]] = field(default_factory=list)
    output: str = 'log'


@dataclass
class Value:
    value: Any
    value_type: type = field(kw_only=True)

    def __post_init__(self) -> None:
        assert isinstance(self.value, self.value_type)      # only substitutions are converted


def prefix_namespace(base_ns: str | None, ns: str | None) -> str | None:
    if ns is None or not base_ns or ns.startswith('/'):
        return base_ns if ns is None else ns
    return f'{base_ns.rstrip("/")}/{ns}'.rstrip('/')


def make_namespace_absolute(ns: str | None) -> str | None:
    return ns if ns is None or ns.startswith('/') else f'/{ns}'


FAKES: dict[str, dict[str, Any]] = {
    'launch': {'LaunchContext': Context, 'LaunchDescription': Description,
               'LaunchDescriptionEntity': object},
    'launch.actions': {'DeclareLaunchArgument': Argument, 'ExecuteProcess': Process,
                       'GroupAction': Group, 'IncludeLaunchDescription': Include,
                       'OpaqueFunction': Function},
    'launch.launch_description_sources': {'PythonLaunchDescriptionSource': Source},
    'launch.substitutions': {'LaunchConfiguration': Configuration, 'PathJoinSubstitution': Joined},
    'launch_ros': {},
    'launch_ros.actions': {'Node': NodeAction, 'PushRosNamespace': Push},
    'launch_ros.parameter_descriptions': {'ParameterValue': Value},
    'launch_ros.substitutions': {'FindPackageShare': Share},
    'launch_ros.utilities': {'make_namespace_absolute': make_namespace_absolute,
                             'prefix_namespace': prefix_namespace},
}


def performed(value: Any, context: Context) -> str:
    return value if isinstance(value, str) else str(value.perform(context))


@pytest.fixture(autouse=True)
def _fakes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Replace the modules of launch and launch_ros."""
    for name, members in FAKES.items():
        module = ModuleType(name)
        vars(module).update(members)
        monkeypatch.setitem(sys.modules, name, module)


@pytest.fixture
def prefixes(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """Return an ament prefix without packages."""
    monkeypatch.setenv('AMENT_PREFIX_PATH', str(tmp_path))
    pytest.importorskip('ament_index_python')
    return tmp_path


@pytest.fixture
def description(prefixes: Path) -> Description:
    """Return the launch description of one node."""
    return described('registration.launch.py')


def described(file: str) -> Description:
    found = runpy.run_path(str(FOLDER / file))['generate_launch_description']()
    assert isinstance(found, Description)
    return found


def arguments_of(description: Description) -> dict[str, Argument]:
    return {each.name: each for each in description.entities if isinstance(each, Argument)}


def actions_of(description: Description, pushed: str = '', **given: str) -> list[Any]:
    """Return the actions started with these arguments, inside of a pushed namespace."""
    arguments = arguments_of(description)
    assert set(given) <= set(arguments)
    context = Context({'ros_namespace': pushed} if pushed else {})
    for name, argument in arguments.items():
        value = given[name] if name in given else performed(argument.default_value, context)
        assert argument.choices is None or value in argument.choices
        context.launch_configurations[name] = value
    function, = (each for each in description.entities if isinstance(each, Function))
    actions: list[Any] = function.function(context)
    return actions


def test_starts_the_node_with_the_default_parameter_file(description: Description) -> None:
    node, = actions_of(description)
    assert (node.package, node.executable, node.name) == ('gsdf_registration', 'registration_node',
                                                          'registration')
    assert node.parameters == [SETTINGS]
    assert node.ros_arguments == ['--log-level', 'registration:=info']
    assert node.output == 'screen'


def test_arguments_override_the_parameter_file(description: Description, tmp_path: Path) -> None:
    file = tmp_path / 'my.yaml'
    file.touch()
    node, = actions_of(description, model='12', config=str(file), session='s.json',
                       autostart='false', use_sim_time='True')
    settings, last = node.parameters
    assert settings == str(file)
    assert node.namespace is not None   # else it would not override a section for this node
    # a name that looks like a number stays a string
    assert last == {'model.path': Value('12', value_type=str),
                    'session.path': Value('s.json', value_type=str),
                    'autostart': False, 'use_sim_time': True}


@pytest.mark.parametrize('pushed, given, name', [
    ('', {}, '/registration'),
    ('', {'namespace': 'hip', 'node_name': 'left'}, '/hip/left'),
    ('/hip', {}, '/hip/registration'),
    ('/theatre', {'namespace': 'hip'}, '/theatre/hip/registration'),
    ('/theatre', {'namespace': '/hip'}, '/hip/registration'),
])
def test_log_level_and_player_use_the_full_name_of_the_node(
        description: Description, bags: Path, pushed: str, given: dict[str, str],
        name: str) -> None:
    bag = str(bags / 'hip_optical')
    node, player = actions_of(description, pushed, bag=bag, log_level='debug', **given)
    assert node.ros_arguments[-1] == f'{name[1:].replace("/", ".")}:=debug'
    assert player.cmd[:4] == [sys.executable, '-m', 'gsdf_registration.clients.play_when_active',
                              name]
    assert player.cmd[4:] == ['ros2', 'bag', 'play', bag, '--rate', '1.0']
    assert player.name == 'player'      # or each line of its output would begin with the command


def test_bag_is_played_at_a_rate_with_its_clock(description: Description, bags: Path) -> None:
    _, player = actions_of(description, bag=str(bags / 'hip_optical'), bag_rate='2.0',
                           use_sim_time='true')
    assert player.cmd[-3:] == ['--rate', '2.0', '--clock']


@pytest.mark.parametrize('argument, sentence', [
    ('config', 'config:=/no/such: there is no such file'),
    ('bag', 'bag:=/no/such: there is no such recording')])
def test_refuses_a_file_that_does_not_exist(description: Description, argument: str,
                                            sentence: str) -> None:
    with pytest.raises(RuntimeError, match=f'^{sentence}$'):
        actions_of(description, **{argument: '/no/such'})


def test_starts_nothing_if_rviz_is_not_installed(description: Description) -> None:
    with pytest.raises(RuntimeError, match='rviz2 is not installed'):
        actions_of(description, rviz='true')


@pytest.mark.parametrize('namespace, node, frame', [('', '/registration', 'bone_centre'),
                                                    ('femur', '/femur/registration',
                                                     'femur_bone_centre')])
def test_rviz_shows_the_topics_of_the_node(description: Description, prefixes: Path,
                                           namespace: str, node: str, frame: str) -> None:
    index = prefixes / 'share/ament_index/resource_index/packages'
    index.mkdir(parents=True)
    (index / 'rviz2').touch()
    _, viewer = actions_of(description, rviz='true', namespace=namespace)
    assert (viewer.package, viewer.executable) == ('rviz2', 'rviz2')
    option, scene, *fixed = viewer.arguments
    assert option == '-d' and fixed == ['--fixed-frame', frame]
    file = Path(performed(scene, Context({})))
    topics = {topic for topic in file.read_text().split() if topic.startswith('/registration/')}
    assert {source: target.removeprefix(node) for source, target in viewer.remappings} == {
        topic: topic.removeprefix('/registration') for topic in topics}


@pytest.mark.parametrize('file', sorted(path.name for path in FOLDER.glob('*.launch.py')))
def test_every_argument_is_described(file: str, prefixes: Path) -> None:
    documented = ' '.join(path.read_text() for path in (ROOT / 'docs').glob('*.md'))
    arguments = arguments_of(described(file))
    assert arguments
    for argument in arguments.values():
        assert len(argument.description) > 10
        assert f'{argument.name}:=' in documented


def test_two_bones_are_two_nodes_in_namespaces(prefixes: Path) -> None:
    description = described('two_bones.launch.py')
    groups = [each for each in description.entities if isinstance(each, Group)]
    assert len(groups) == 2
    for group, bone in zip(groups, ('femur', 'tibia')):
        push, include = group.actions
        assert push == Push(bone)
        assert Path(performed(include.source.location, Context({}))) == (
            FOLDER / 'registration.launch.py')
        given = dict(include.launch_arguments)
        assert given['model'] == Configuration(bone)
        assert given.keys() <= arguments_of(described('registration.launch.py')).keys()
    settings = arguments_of(description)['config'].default_value
    assert Path(performed(settings, Context({}))).is_file()
