# SPDX-License-Identifier: Apache-2.0
"""A bone as a surface: checked, repaired, oriented."""
