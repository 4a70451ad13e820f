# SPDX-License-Identifier: Apache-2.0
"""Latency and processor load of the live pose of a node."""
