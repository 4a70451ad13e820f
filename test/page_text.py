# SPDX-License-Identifier: Apache-2.0
"""The text of an HTML page, as a reader sees it."""

from __future__ import annotations

import re


def text_of(page: str) -> str:
    """Return the text of a page without its scripts, with single spaces."""
    page = re.sub(r'<(script|style).*?</\1>', '', page, flags=re.DOTALL)
    return re.sub(r'\s+', ' ', re.sub(r'<[^>]+>', ' ', page))
