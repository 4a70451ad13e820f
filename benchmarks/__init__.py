# SPDX-License-Identifier: Apache-2.0
"""Benchmarks: accuracy and speed beside other libraries, on seeded problems with ground truth."""
