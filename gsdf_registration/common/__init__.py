# SPDX-License-Identifier: Apache-2.0
"""Basic types and functions: rigid motions, settings, results, samples, formatting."""
