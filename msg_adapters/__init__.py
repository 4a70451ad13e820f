# SPDX-License-Identifier: Apache-2.0
"""Adapters for messages and file formats, which convert them to and from arrays in SI units."""
