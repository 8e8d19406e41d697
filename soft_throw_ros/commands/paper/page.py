# SPDX-License-Identifier: Apache-2.0
"""The page `docs/paper.md`: all figures, and the paper's numbers beside ours."""

from __future__ import annotations

from collections.abc import Iterable
import math

from soft_throw_ros.commands.paper.catalogue import Drawing, DRAWINGS
from soft_throw_ros.commands.paper.comparison import beyond, published, Row
from soft_throw_ros.design.recommendation import best_ratios


def write_page(kind: str) -> str:
    """
    Write the page.

    Parameters
    ----------
    kind : str
        Format of the figures, as their names end.

    Returns
    -------
    str
        Markdown.

    """
    figures = '\n'.join(
        _figure(drawing, kind) for drawing in DRAWINGS.values() if drawing.is_of_paper
    )
    rows = (
        (row.quantity, row.where, row.paper.text, _ours(row), _difference(row), _why(row))
        for row in published()
    )
    return _TEMPLATE.format(
        figures=figures,
        published=_table(('quantity', 'where', 'paper', 'ours', 'difference', 'why'), rows),
        beyond=_table(('quantity', 'ours'), beyond()),
        misprints=_misprints(),
    )


def _figure(drawing: Drawing, kind: str) -> str:
    return f'## {drawing.title}\n\n![{drawing.title}]({drawing.path(kind)})\n\n{drawing.text}\n'


def _ours(row: Row) -> str:
    values = row.ours if isinstance(row.ours, tuple) else (row.ours,)
    return ' to '.join(f'{value:.{row.digits}f}' for value in values)


def _difference(row: Row) -> str:
    if row.difference is None:
        return 'within' if row.agrees else 'beyond'
    text = f'{row.difference:+.{row.digits}f}'
    return '0' if float(text) == 0.0 else text


def _why(row: Row) -> str:
    if not row.agrees:
        return row.why
    return f'as printed; {row.why}' if row.why else 'as printed'


def _table(header: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> str:
    lines = [header, tuple('---' for _ in header), *rows]
    return '\n'.join(f'| {" | ".join(line)} |' for line in lines)


def _misprints() -> str:
    """List what is printed wrong and is no number, or one of many."""
    best = best_ratios(0.0)
    right = math.exp(-2.0 / best.mass_ratio)
    wrong = math.exp(-4.0 * math.pi * best.mass_ratio / best.speed_ratio)
    return f"""\
- The strain at the contact goes from compression to tension at the release, so du/dy from negative
  to positive; a sentence has it the other way round.
- V_m(3 t_s) has the factor e^(-2 t_s/tau), not e^(-2 omega tau): at the optimum {right:.4f}, not
  {wrong:.2f}.
- The last term of Eq. (14) lacks the factor 2 A omega."""


_TEMPLATE = """\
# The paper, computed again

The figures of "Use of compliant actuators for throwing rigid projectiles", Phys. Rev. E (2022),
that the models can make, and the numbers that it prints beside ours. The figures show the paper's
quantities over its axes, in an arrangement of our own. What the paper says is red; all else is
computed, by `make figures` (`soft-throw figures --output docs`), which writes this page, too.

Unless it says otherwise: no gravity, no loss, a rigid projectile, and the first release. As in the
paper, x = L_s/(L_s + L_r) and C = c_s/(L_s + L_r)f. What decides is mu = m/(rho_s S L_s)
and kappa = c_s/(L_s f); t_s = L_s/c_s is one crossing of the layer, tau = mu t_s, and
alpha = (V_e/V_p*)^2.

{figures}
## Its numbers

"As printed" means: within half a unit of the last digit, or within the range that is given.

{published}

## What it does not say

{beyond}

## Misprints beside those in the table

{misprints}
"""
