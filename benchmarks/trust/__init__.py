# SPDX-License-Identifier: Apache-2.0
"""How often an accepted pose is wrong, and a well-posed problem rejected."""
