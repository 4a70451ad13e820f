# SPDX-License-Identifier: Apache-2.0
"""A recording of a real phantom, with targets that were measured beside it."""
