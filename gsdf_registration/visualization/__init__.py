# SPDX-License-Identifier: Apache-2.0
"""Reports and pictures of a registration."""

from gsdf_registration.visualization.report import require_pillow, write_report
from gsdf_registration.visualization.report_content import ReportContent

__all__ = ['ReportContent', 'require_pillow', 'write_report']
