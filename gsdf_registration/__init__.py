# SPDX-License-Identifier: Apache-2.0
"""Find a bone under a tracked probe: partial-to-full registration on gradient-SDFs."""

__version__ = '0.1.0'
