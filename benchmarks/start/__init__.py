# SPDX-License-Identifier: Apache-2.0
"""The first start of the node on a machine."""
