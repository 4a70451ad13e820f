# SPDX-License-Identifier: Apache-2.0
"""Whether the stated errors are true."""
