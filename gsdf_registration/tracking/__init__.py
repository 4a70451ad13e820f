# SPDX-License-Identifier: Apache-2.0
"""How points come into the frame of the session, each at its own stamp."""
