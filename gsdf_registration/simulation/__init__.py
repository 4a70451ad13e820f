# SPDX-License-Identifier: Apache-2.0
"""Simulated bones and recordings with ground truth, for tests, benchmarks and the demo."""
