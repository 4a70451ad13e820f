# SPDX-License-Identifier: Apache-2.0
"""
The actions of the launch file.

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
FILE = ROOT / 'launch/registration.launch.py'
SETTINGS = '<share of gsdf_registration>/config/registration.yaml'


@dataclass
class Context:
    given: dict[str, str]


@dataclass
class Configuration:
    name: str

    def perform(self, context: Context) -> str:
        return context.given[self.name]


@dataclass
class Share:
    package: str

    def perform(self, context: Context) -> str:
        return f'<share of {self.package}>'


@dataclass
class Joined:
    parts: list[Any]

    def perform(self, context: Context) -> str:
        return '/'.join(performed(part, context) for part in self.parts)


@dataclass
class If:
    predicate: Configuration

    def evaluate(self, context: Context) -> bool:
        return {'true': True, 'false': False}[self.predicate.perform(context)]


@dataclass
class Description:
    entities: list[Any]


@dataclass
class Argument:
    name: str
    default_value: Any = field(kw_only=True)
    description: str = field(kw_only=True)


@dataclass(kw_only=True)
class Function:
    function: Any


@dataclass(kw_only=True)
class Process:
    cmd: list[str]
    shell: bool = False
    name: str | None = None
    output: str = 'log'
    condition: If | None = None


@dataclass(kw_only=True)
class NodeAction:
    package: str
    executable: str
    name: str
    namespace: str | None = None
    parameters: list[Any] = field(default_factory=list)
    arguments: list[Any] = field(default_factory=list)
    ros_arguments: list[Any] = field(default_factory=list)
    output: str = 'log'
    condition: If | None = None


@dataclass
class Value:
    value: Any
    value_type: type = field(kw_only=True)


FAKES: dict[str, dict[str, Any]] = {
    'launch': {'LaunchContext': Context, 'LaunchDescription': Description,
               'LaunchDescriptionEntity': object},
    'launch.actions': {'DeclareLaunchArgument': Argument, 'ExecuteProcess': Process,
                       'OpaqueFunction': Function},
    'launch.conditions': {'IfCondition': If},
    'launch.substitutions': {'LaunchConfiguration': Configuration, 'PathJoinSubstitution': Joined},
    'launch_ros': {},
    'launch_ros.actions': {'Node': NodeAction},
    'launch_ros.parameter_descriptions': {'ParameterValue': Value},
    'launch_ros.substitutions': {'FindPackageShare': Share},
}


def performed(value: Any, context: Context) -> str:
    return value if isinstance(value, str) else str(value.perform(context))


@pytest.fixture
def description(monkeypatch: pytest.MonkeyPatch) -> Description:
    """Return the launch description of the file."""
    for name, members in FAKES.items():
        module = ModuleType(name)
        vars(module).update(members)
        monkeypatch.setitem(sys.modules, name, module)
    described = runpy.run_path(str(FILE))['generate_launch_description']()
    assert isinstance(described, Description)
    return described


def actions_of(description: Description, **given: str) -> tuple[Context, list[Any]]:
    """Return the actions started with these command line arguments."""
    arguments = {each.name: each for each in description.entities if isinstance(each, Argument)}
    assert set(given) <= set(arguments)
    context = Context(given)
    context.given = {name: given[name] if name in given else
                     performed(argument.default_value, context)
                     for name, argument in arguments.items()}
    actions: list[Any] = []
    for entity in description.entities:
        if isinstance(entity, Function):
            actions += entity.function(context)
        elif not isinstance(entity, Argument) and entity.condition.evaluate(context):
            actions.append(entity)
    return context, actions


def test_starts_the_node_with_the_default_parameter_file(description: Description) -> None:
    _, (node,) = actions_of(description)
    assert (node.package, node.executable, node.name) == ('gsdf_registration', 'registration_node',
                                                          'registration')
    assert node.parameters == [SETTINGS]
    assert node.ros_arguments == ['--log-level', 'registration:=info']
    assert node.output == 'screen'


def test_model_argument_overrides_the_parameter_file(description: Description) -> None:
    _, (node,) = actions_of(description, model='12', config='my.yaml', log_level='debug')
    settings, last = node.parameters
    assert settings == 'my.yaml'
    assert node.namespace is not None   # else it would not override a section for this node
    # a name that looks like a number stays a string
    assert last == {'model.path': Value('12', value_type=str)}
    assert node.ros_arguments[-1] == 'registration:=debug'


def test_plays_a_bag_once_the_node_is_active(description: Description) -> None:
    _, (_, player) = actions_of(description, bag="a 'quoted' bag")
    command, = player.cmd
    assert player.shell
    assert player.name == 'player'      # or each line of its output would begin with the command
    assert command.startswith('until ros2 lifecycle get /registration')
    assert command.endswith("""exec ros2 bag play 'a '"'"'quoted'"'"' bag'""")


def test_rviz_uses_the_shipped_configuration(description: Description) -> None:
    context, (_, viewer) = actions_of(description, rviz='true')
    assert (viewer.package, viewer.executable) == ('rviz2', 'rviz2')
    option, scene = viewer.arguments
    assert option == '-d'
    folder, _, file = performed(scene, context).partition('/')
    assert folder == '<share of gsdf_registration>'
    assert (ROOT / file).is_file()


def test_every_argument_has_a_description_and_is_in_the_readme(description: Description) -> None:
    arguments = [each for each in description.entities if isinstance(each, Argument)]
    assert {each.name for each in arguments} == {'model', 'config', 'bag', 'rviz', 'log_level'}
    for argument in arguments:
        assert len(argument.description) > 10
        assert f'{argument.name}:=' in (ROOT / 'README.md').read_text()
