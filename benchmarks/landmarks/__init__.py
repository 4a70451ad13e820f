# SPDX-License-Identifier: Apache-2.0
"""How much a joint centre adds to points at the other end of the bone."""
