# SPDX-License-Identifier: Apache-2.0
"""The experiments of the publication, also run with other libraries."""
