# SPDX-License-Identifier: Apache-2.0
"""Other registration libraries: in this process, or in separate environments and processes."""
