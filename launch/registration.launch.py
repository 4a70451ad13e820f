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
    """Return the node and, when a bag is given, its player."""
    model, config, bag, log_level = (
        LaunchConfiguration(name).perform(context)
        for name in ('model', 'config', 'bag', 'log_level'))

    # model:= wins over model.path in the settings file only when it is given; and, as the namespace
    # is named below, also over a section of that file which is for this node alone
    given = [{'model.path': ParameterValue(model, value_type=str)}] if model else []
    # the node brings itself to active (parameter autostart)
    node = Node(package='gsdf_registration', executable='registration_node', name='registration',
                namespace='', parameters=[config, *given],
                ros_arguments=['--log-level', f'registration:={log_level}'], output='screen')
    # the node keeps no points before it is active, and its first start ever compiles for a while
    wait = 'until ros2 lifecycle get /registration 2>&1 | grep --quiet ^active; do sleep 1; done'
    player = ExecuteProcess(cmd=[f'{wait}; exec ros2 bag play {quote(bag)}'], shell=True,
                            name='player', output='screen')
    return [node, player] if bag else [node]


def generate_launch_description() -> LaunchDescription:
    """Return the arguments and what they start."""
    return LaunchDescription([
        DeclareLaunchArgument(
            'model',
            default_value='',
            description='bone model: path or package:// URI; empty: as in the settings'),
        DeclareLaunchArgument(
            'config',
            default_value=PathJoinSubstitution([SHARE, 'config', 'registration.yaml']),
            description='settings, a ROS parameter file'),
        DeclareLaunchArgument('bag', default_value='',
                              description='recording to play; empty: none'),
        DeclareLaunchArgument('rviz', default_value='false',
                              description='true: show bone, points and where to touch in RViz'),
        DeclareLaunchArgument('log_level', default_value='info',
                              description='of the node: debug, info, warn, error or fatal'),
        OpaqueFunction(function=start),
        Node(package='rviz2', executable='rviz2', name='rviz',
             arguments=['-d', PathJoinSubstitution([SHARE, 'config', 'registration.rviz'])],
             condition=IfCondition(LaunchConfiguration('rviz'))),
    ])
