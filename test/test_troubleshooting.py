# SPDX-License-Identifier: Apache-2.0
"""Test that the messages and the names in the troubleshooting page exist in the code."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

from gsdf_registration.common.config import settings
from gsdf_registration.common.samples import Rejection

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / 'docs/troubleshooting.md').read_text()
QUOTES = re.findall(r'^> (.+)$', PAGE, re.MULTILINE)


@pytest.fixture(scope='module')
def sentences() -> str:
    """Return every string of the sources, one per line, with … for inserted values."""
    texts = set()
    for package in ('gsdf_registration', 'msg_adapters', 'launch', 'examples'):
        for file in (ROOT / package).rglob('*.py'):
            for node in ast.walk(ast.parse(file.read_text())):
                if isinstance(node, ast.JoinedStr):
                    texts.add(''.join(part.value if isinstance(part, ast.Constant) else '…'
                                      for part in node.values))
                elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                    texts.add(node.value)
    return '\n'.join(texts)


@pytest.mark.parametrize('quote', QUOTES)
def test_quote_is_a_message_of_the_code(quote: str, sentences: str) -> None:
    assert quote in sentences


def test_page_has_quotes() -> None:
    assert len(QUOTES) > 30


def test_named_settings_and_causes_exist() -> None:
    known = {name for name, _ in settings()} | {name.split('.')[0] for name, _ in settings()}
    words = set(re.findall(r'`([a-z]+\.[a-z_]+)`', PAGE))
    assert words - {'rejected.*'} <= known
    causes = {'duplicate', 'not_monotonic', 'not_collecting'}
    assert all(f'`{cause}`' in PAGE for cause in causes)
    assert causes <= {str(cause) for cause in Rejection}
