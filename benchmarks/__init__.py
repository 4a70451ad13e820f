# SPDX-License-Identifier: Apache-2.0
"""Seeded trials on bones with a known truth: what is asked, how it is scored, how many are run."""
