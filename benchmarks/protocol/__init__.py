# SPDX-License-Identifier: Apache-2.0
"""The problems: bones, exposed areas, scenarios and seeds, and how an answer is scored."""
