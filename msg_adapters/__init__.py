# SPDX-License-Identifier: Apache-2.0
"""
The only place that knows messages, frames, units and file formats; it hands out plain arrays in SI.
"""
