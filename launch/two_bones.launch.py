# SPDX-License-Identifier: Apache-2.0
"""
Start one registration node for each of two bones, in the namespaces femur and tibia.

``ros2 launch gsdf_registration two_bones.launch.py femur:=femur.stl tibia:=tibia.stl``.
"""

from __future__ import annotations

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, GroupAction, IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import PushRosNamespace
from launch_ros.substitutions import FindPackageShare

SHARE = FindPackageShare('gsdf_registration')
BONES = ['femur', 'tibia']


def node_of(bone: str) -> GroupAction:
    """Return the node of a bone; the other arguments of the launch file are passed on."""
    included = PythonLaunchDescriptionSource(
        PathJoinSubstitution([SHARE, 'launch', 'registration.launch.py']))
    return GroupAction([
        PushRosNamespace(bone),
        IncludeLaunchDescription(included, launch_arguments={
            'model': LaunchConfiguration(bone), 'config': LaunchConfiguration('config')}.items())])


def generate_launch_description() -> LaunchDescription:
    """Return the arguments and the nodes."""
    models = [DeclareLaunchArgument(bone, default_value='',
                                    description=f'model of the {bone}, a path or package:// URI; '
                                                'empty: model.path of the parameter file')
              for bone in BONES]
    return LaunchDescription([
        *models,
        DeclareLaunchArgument(
            'config', default_value=PathJoinSubstitution([SHARE, 'examples', 'two_bones.yaml']),
            description='ROS parameter file with the settings of both nodes'),
        *map(node_of, BONES),
    ])
