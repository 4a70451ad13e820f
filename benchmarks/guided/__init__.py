# SPDX-License-Identifier: Apache-2.0
"""How many points are needed with guidance and at random."""
