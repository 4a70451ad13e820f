# SPDX-License-Identifier: Apache-2.0
"""Other libraries that find a bone under points, in environments and processes of their own."""
