# SPDX-License-Identifier: Apache-2.0
"""
Start the registration node.

``ros2 launch gsdf_registration registration.launch.py model:=hip.stl``.
"""

from __future__ import annotations

import sys
from pathlib import Path

from ament_index_python.packages import PackageNotFoundError, get_package_prefix
from launch import LaunchContext, LaunchDescription, LaunchDescriptionEntity
from launch.actions import DeclareLaunchArgument, ExecuteProcess, OpaqueFunction
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare
from launch_ros.utilities import make_namespace_absolute, prefix_namespace

from gsdf_registration.common.config import NAMES
from gsdf_registration.common.naming import centre_frame, prefix_of

SHARE = FindPackageShare('gsdf_registration')
SWITCH = ['true', 'false', 'True', 'False']
LEVELS = ['debug', 'info', 'warn', 'error', 'fatal']
# the topics in config/registration.rviz
SHOWN = ['markers', 'points', 'live_pose', 'tip']
# the parameters that arguments override if they are given
OVERRIDES = {'model': 'model.path', 'session': 'session.path', 'autostart': 'autostart',
             'use_sim_time': 'use_sim_time'}


def start(context: LaunchContext) -> list[LaunchDescriptionEntity]:
    """Return the node and, if requested, RViz and the player of the bag."""
    arguments = {each: LaunchConfiguration(each).perform(context) for each in (
        'namespace', 'node_name', 'config', 'bag', 'bag_rate', 'rviz', 'log_level', *OVERRIDES)}
    check(arguments)    # before anything is started
    # None without PushRosNamespace
    pushed = context.launch_configurations.get('ros_namespace', None)
    namespace = make_namespace_absolute(prefix_namespace(pushed, arguments['namespace']))
    node = make_namespace_absolute(prefix_namespace(namespace, arguments['node_name']))

    # They override a section of the parameter file for this node alone, too, because the namespace
    # of the node is set explicitly.
    given = {parameter: value_of(each, arguments[each])
             for each, parameter in OVERRIDES.items() if arguments[each]}
    actions = [Node(
        package='gsdf_registration', executable='registration_node', name=arguments['node_name'],
        namespace=arguments['namespace'], parameters=[arguments['config'], *[given] * bool(given)],
        ros_arguments=['--log-level', f'{logger_of(node)}:={arguments["log_level"]}'],
        output='screen')]
    if is_true(arguments['rviz']):
        actions.append(rviz(node, arguments['namespace']))
    if arguments['bag']:
        clock = ['--clock'] * is_true(arguments['use_sim_time'])
        actions.append(ExecuteProcess(
            cmd=[sys.executable, '-m', 'gsdf_registration.clients.play_when_active', node,
                 'ros2', 'bag', 'play', arguments['bag'], '--rate', arguments['bag_rate'], *clock],
            name='player', output='screen'))
    return actions


def check(arguments: dict[str, str]) -> None:
    """Raise a RuntimeError with one sentence if something that is needed does not exist."""
    if not Path(arguments['config']).is_file():
        raise RuntimeError(f'config:={arguments["config"]}: there is no such file')
    if arguments['bag'] and not Path(arguments['bag']).exists():
        raise RuntimeError(f'bag:={arguments["bag"]}: there is no such recording')
    if is_true(arguments['rviz']):
        try:
            get_package_prefix('rviz2')
        except PackageNotFoundError:
            raise RuntimeError('rviz:=true: rviz2 is not installed; install ros-jazzy-rviz2 or '
                               'launch without rviz:=true') from None


def is_true(switch: str) -> bool:
    """Return the value of an argument whose choices are `SWITCH`."""
    return switch.lower() == 'true'


def value_of(argument: str, given: str) -> bool | ParameterValue:
    """Return the value of a parameter; a path that looks like a number stays a string."""
    if argument in ('autostart', 'use_sim_time'):
        return is_true(given)
    return ParameterValue(given, value_type=str)


def logger_of(node: str) -> str:
    """Return the name of the logger of the node with this fully qualified name."""
    return node.strip('/').replace('/', '.')


def rviz(node: str, namespace: str) -> Node:
    """Return RViz with the topics of the node, looking at the centre of its bone."""
    frame = centre_frame(prefix_of(*node.rsplit('/', 1)) + NAMES['model.frame_id'])
    return Node(
        package='rviz2', executable='rviz2', name='rviz', namespace=namespace,
        arguments=['-d', PathJoinSubstitution([SHARE, 'config', 'registration.rviz']),
                   '--fixed-frame', frame],
        remappings=[(f'/registration/{topic}', f'{node}/{topic}') for topic in SHOWN])


def generate_launch_description() -> LaunchDescription:
    """Return the arguments and the actions of the launch file."""
    return LaunchDescription([
        DeclareLaunchArgument(
            'model', default_value='',
            description='bone model, a path or package:// URI; empty: model.path of the parameter '
                        'file'),
        DeclareLaunchArgument(
            'config',
            default_value=PathJoinSubstitution([SHARE, 'config', 'registration.yaml']),
            description='ROS parameter file with the settings'),
        DeclareLaunchArgument(
            'namespace', default_value='',
            description='namespace of the node, such as femur, after which frames and files are '
                        'named'),
        DeclareLaunchArgument('node_name', default_value='registration',
                              description='name of the node'),
        DeclareLaunchArgument(
            'session', default_value='',
            description='session file of ~/save and ~/load; empty: session.path of the parameter '
                        'file'),
        DeclareLaunchArgument(
            'autostart', default_value='', choices=['', *SWITCH],
            description='false: a lifecycle manager configures and activates the node; empty: as '
                        'in the parameter file, else true'),
        DeclareLaunchArgument(
            'use_sim_time', default_value='', choices=['', *SWITCH],
            description='true: take the time from /clock, which bag:= then publishes; empty: as '
                        'in the parameter file, else false'),
        DeclareLaunchArgument('bag', default_value='',
                              description='rosbag2 recording to play once the node is active; '
                                          'empty: none'),
        DeclareLaunchArgument('bag_rate', default_value='1.0',
                              description='speed of bag:= relative to the recording'),
        DeclareLaunchArgument('rviz', default_value='false', choices=SWITCH,
                              description='true: start RViz with the bone, the points and the next '
                                          'places to touch'),
        DeclareLaunchArgument('log_level', default_value='info', choices=LEVELS,
                              description='log level of the node'),
        OpaqueFunction(function=start),
    ])
