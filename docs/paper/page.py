# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Tables of the pages in docs, which stand between two comments of a page."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
import re

from comparison import optima, published


def update_page(page: str) -> str:
    """Return the page `docs/paper.md` with its tables computed again."""
    for name, heads, rows in (
        ('published', ('quantity (section)', 'paper', 'ours', 'remark'),
         [row.cells for row in published()]),
        ('beyond', ('quantity', 'ours'), optima()),
    ):
        page = replace_part(page, name, table(heads, rows))
    return page


def table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table in Markdown."""
    lines = [heads, ['---'] * len(heads), *rows]
    return '\n'.join(f'| {" | ".join(line)} |' for line in lines)


def replace_part(page: str, name: str, part: str) -> str:
    """Return a page with other text between the comments `<!-- name -->` and `<!-- end -->`."""
    pattern = rf'(<!-- {name} -->\n).*?(\n<!-- end -->)'
    result, count = re.subn(
        pattern, lambda match: match[1] + part + match[2], page, flags=re.DOTALL
    )
    if count != 1:
        raise ValueError(f'the page must have one part {name!r}, got {count}')
    return result
