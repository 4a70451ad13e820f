# SPDX-License-Identifier: Apache-2.0
"""Cases that the path of the probe through the air decides."""
