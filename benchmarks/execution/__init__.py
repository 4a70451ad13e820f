# SPDX-License-Identifier: Apache-2.0
"""Run many jobs on all cores and store their rows, so that a run can be resumed."""
