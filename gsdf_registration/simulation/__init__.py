# SPDX-License-Identifier: Apache-2.0
"""Bones that never lived and probes nobody held: known truth for tests, benchmarks and demos."""
