# SPDX-License-Identifier: Apache-2.0
"""Compare accuracy and speed with other libraries, on seeded problems with ground truth."""
