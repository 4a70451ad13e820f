# SPDX-License-Identifier: Apache-2.0
"""The experiments of the publication, repeated beside other libraries."""
