# SPDX-License-Identifier: Apache-2.0
"""Reports and pictures of a registration."""

from gsdf_registration.visualization.report import require_plotly, write_report

__all__ = ['require_plotly', 'write_report']
