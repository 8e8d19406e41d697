# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Common style of the figures, and tables of the pages in docs."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
import re
from typing import Any

from matplotlib import style
from matplotlib.axes import Axes
from matplotlib.figure import Figure
import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]

# Colours of Okabe and Ito, which colour-blind readers can distinguish
BLACK = '#000000'
BLUE = '#0072b2'
ORANGE = '#e69f00'
GREEN = '#009e73'
RED = '#d55e00'
SKY = '#56b4e9'

WIDTH = 8.4  # of every figure: fills a page of GitHub at 150 dots per inch [in]
MILLI = 1e3  # millimetres in a metre, and milliseconds in a second

X_LABEL = '$x = L_s/(L_s+L_r)$'
C_LABEL = '$C = c_s/(L_s+L_r)f$'

PAPER: dict[str, Any] = {
    'color': RED, 'marker': '*', 'markersize': 14, 'markeredgecolor': 'white',
    'linestyle': 'none', 'zorder': 5,
}
"""Marker of a number that the paper gives."""

_SETTINGS: Any = {
    'axes.axisbelow': True, 'axes.spines.right': False, 'axes.spines.top': False,
    'axes.titlelocation': 'left', 'axes.titlesize': 'medium', 'font.size': 10.0,
    'legend.fontsize': 9.0, 'legend.frameon': False, 'lines.linewidth': 1.6,
    'mathtext.fontset': 'dejavusans', 'savefig.dpi': 150,
}


def settings() -> AbstractContextManager[None]:
    """Return a context in which figures do not depend on the settings of the user."""
    return style.context(_SETTINGS, after_reset=True)


def new_figure(
    title: str, caption: str, *, height: float, grid: tuple[int, int] = (1, 2), **options: Any
) -> tuple[Figure, Any]:
    """
    Return a figure with a bold title and a caption of one or two lines, and its empty panels.

    Rows and columns of the grid, and the options, are those of `Figure.subplots`.
    """
    figure = Figure(figsize=(WIDTH, height), layout='constrained')
    bold = title.replace(' ', r'\ ').replace(':', '{:}')
    text = rf'$\mathbf{{{bold}}}$' + f'\n{caption}'
    figure.suptitle(text, x=0.01, ha='left', fontsize='medium', linespacing=1.4)
    return figure, figure.subplots(*grid, **options)


def legend_below(figure: Figure, *panels: Axes, columns: int) -> Figure:
    """Add one legend for the labels of some panels below all panels; return the figure."""
    handles: dict[str, Any] = {}
    for axes in panels:
        shown, labels = axes.get_legend_handles_labels()
        handles |= dict(zip(labels, shown, strict=True))
    figure.legend([*handles.values()], [*handles], loc='outside lower center', ncols=columns)
    return figure


def broken(values: ArrayLike) -> Floats:
    """Return a copy with NaN at jumps, where a line is interrupted."""
    copy = np.array(values, dtype=np.float64)
    steps = np.abs(np.diff(copy))
    nearby = np.lib.stride_tricks.sliding_window_view(np.pad(steps, 4, mode='edge'), 9)
    spread = np.ptp(np.quantile(copy, (0.1, 0.9)))
    copy[1:][steps > 4.0 * np.median(nearby, axis=1) + 2e-3 * spread] = np.nan
    return copy


def save(figure: Figure, path: Path) -> None:
    """Write a figure as PNG, without the version of matplotlib, so that bytes do not change."""
    figure.savefig(path, metadata={'Software': None}, pil_kwargs={'optimize': True})


def table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table in Markdown."""
    lines = [heads, ['---'] * len(heads), *rows]
    return '\n'.join(f'| {" | ".join(line)} |' for line in lines)


def replace_part(page: str, name: str, part: str) -> str:
    """Return a page with other text between the comments `<!-- name -->` and `<!-- end -->`."""
    pattern = rf'(?<=<!-- {name} -->\n).*?(?=\n<!-- end -->)'
    result, count = re.subn(pattern, lambda _: part, page, flags=re.DOTALL)
    if count != 1:
        raise ValueError(f'the page must have one part {name!r}, got {count}')
    return result
