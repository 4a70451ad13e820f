# SPDX-License-Identifier: Apache-2.0
"""The surface of a bone: validation, mesh repair, orientation."""
