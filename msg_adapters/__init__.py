# SPDX-License-Identifier: Apache-2.0
"""The only place that knows messages, frames, units, file formats; it hands out arrays in SI."""
