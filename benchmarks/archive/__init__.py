# SPDX-License-Identifier: Apache-2.0
"""A simulated archive of recordings, and how fast it is registered."""
