# SPDX-License-Identifier: Apache-2.0
"""The ROS node, and nothing but the node: it passes messages to the session and results back."""
