# Copyright 2026 soft_throw_ros developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.
"""The page `docs/paper.md`: all figures, and the paper's numbers beside ours."""

from __future__ import annotations

from collections.abc import Iterable
import math

from comparison import beyond, published, Row, throws_of_the_rig
from models import best_layer


def write_page(figures: str) -> str:
    """
    Write the page.

    Parameters
    ----------
    figures : str
        Markdown of the figures.

    Returns
    -------
    str
        Markdown.

    """
    rows = (
        (row.quantity, row.where, row.paper.text, _ours(row), _difference(row), _why(row))
        for row in published()
    )
    best = best_layer(0.0)
    return _TEMPLATE.format(
        figures=figures,
        published=_table(('quantity', 'where', 'paper', 'ours', 'difference', 'why'), rows),
        throws=_table(_HEADS, throws_of_the_rig()),
        beyond=_table(('quantity', 'ours'), beyond()),
        right=math.exp(-2.0 / best.mass_ratio),
        wrong=math.exp(-4.0 * math.pi * best.mass_ratio / best.speed_ratio),
    )


_HEADS = (
    'f (Hz)', 'L_r (mm)', 'L_s (mm)', 'x', 'mu', 'kappa', 't_s (ms)', 't_e (ms)', 't_e f',
    'V_e (m/s)', 'alpha', 'strain (%)', 're-contacts',
)


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


_TEMPLATE = """\
# The paper, computed again

The figures of "Use of compliant actuators for throwing rigid projectiles", Phys. Rev. E (2022),
that the models can make, and the numbers that it prints beside ours. All is computed by
`make figures`, whose scripts are in [paper](paper); what the paper says is red.

What is known of the paper here are its equations, its numbers and what its figures show, not its
pictures and not its measurements. So a figure has the number of the paper's and shows the same
quantities over the same axes, in an arrangement of our own. Where the paper has measured points,
there are computed ones, and the caption says so. The paper's Table I is not at hand either; the
table of throws below has what the models give for the same rig.

Unless it says otherwise: no gravity, no loss, a rigid projectile, and the first release. As in the
paper, x = L_s/(L_s + L_r) and C = c_s/(L_s + L_r)f. What decides is mu = m/(rho_s S L_s)
and kappa = c_s/(L_s f); t_s = L_s/c_s is one crossing of the layer, tau = mu t_s, and
alpha = (V_e/V_p*)^2.

{figures}
## Its numbers

"As printed" means: within half a unit of the last digit, or within the range that is given.

{published}

## The throws of the rig

Three series and six layers, with A = 2 mm, zeta = 0.064, no gravity: first releases, the largest
strain up to them, and how often the layer catches up with the projectile afterwards.

{throws}

## What it does not say

{beyond}

## Misprints beside those in the table

- The strain at the contact goes from compression to tension at the release, so du/dy from negative
  to positive; a sentence has it the other way round.
- V_m(3 t_s) has the factor e^(-2 t_s/tau), not e^(-2 omega tau): at the optimum {right:.4f}, not
  {wrong:.2f}.
- The last term of Eq. (14) lacks the factor 2 A omega.
"""
