# SPDX-License-Identifier: Apache-2.0
"""What every other room stands on: rigid motions, settings, results, samples, formatting."""
