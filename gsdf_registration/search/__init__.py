# SPDX-License-Identifier: Apache-2.0
"""Where the bone may be, with no first guess."""
