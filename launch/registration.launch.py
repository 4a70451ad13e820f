# SPDX-License-Identifier: Apache-2.0
"""
Start the registration node.

``ros2 launch gsdf_registration registration.launch.py model:=hip.stl``.
"""

from __future__ import annotations

from shlex import quote

from launch import LaunchContext, LaunchDescription, LaunchDescriptionEntity
from launch.actions import DeclareLaunchArgument, ExecuteProcess, OpaqueFunction
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

SHARE = FindPackageShare('gsdf_registration')


def start(context: LaunchContext) -> list[LaunchDescriptionEntity]:
    """Return the node and, if a bag is given, its player."""
    model, config, bag, log_level = (
        LaunchConfiguration(name).perform(context)
        for name in ('model', 'config', 'bag', 'log_level'))

    # model:= overrides model.path of the parameter file only if it is given. It also overrides a
    # section for this node alone, because the namespace of the node is set explicitly below.
    given = [{'model.path': ParameterValue(model, value_type=str)}] if model else []
    # the node activates itself (parameter autostart)
    node = Node(package='gsdf_registration', executable='registration_node', name='registration',
                namespace='', parameters=[config, *given],
                ros_arguments=['--log-level', f'registration:={log_level}'], output='screen')
    # the node ignores points until it is active; on the first start it compiles its kernels before
    wait = 'until ros2 lifecycle get /registration 2>&1 | grep --quiet ^active; do sleep 1; done'
    player = ExecuteProcess(cmd=[f'{wait}; exec ros2 bag play {quote(bag)}'], shell=True,
                            name='player', output='screen')
    return [node, player] if bag else [node]


def generate_launch_description() -> LaunchDescription:
    """Return the arguments and the actions of the launch file."""
    return LaunchDescription([
        DeclareLaunchArgument(
            'model',
            default_value='',
            description='bone model, a path or package:// URI; empty: model.path of the parameter '
                        'file'),
        DeclareLaunchArgument(
            'config',
            default_value=PathJoinSubstitution([SHARE, 'config', 'registration.yaml']),
            description='ROS parameter file with the settings'),
        DeclareLaunchArgument('bag', default_value='',
                              description='rosbag2 recording to play; empty: none'),
        DeclareLaunchArgument('rviz', default_value='false',
                              description='true: start RViz with the bone, the points and the next '
                                          'places to touch'),
        DeclareLaunchArgument('log_level', default_value='info',
                              description='log level of the node: debug, info, warn, error or '
                                          'fatal'),
        OpaqueFunction(function=start),
        Node(package='rviz2', executable='rviz2', name='rviz',
             arguments=['-d', PathJoinSubstitution([SHARE, 'config', 'registration.rviz'])],
             condition=IfCondition(LaunchConfiguration('rviz'))),
    ])
