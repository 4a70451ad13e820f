# SPDX-License-Identifier: Apache-2.0
"""Transform tracked points to the session frame; find the fixed point of a moving body."""
