# SPDX-License-Identifier: Apache-2.0
"""What the operator's console costs, and how fast it is."""
