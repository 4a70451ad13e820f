# SPDX-License-Identifier: Apache-2.0
"""A registration as one HTML page that needs no network: what was found, and how good it is."""

from gsdf_registration.visualization.page import require_plotly, write_report

__all__ = ['require_plotly', 'write_report']
