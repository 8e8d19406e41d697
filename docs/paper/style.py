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
"""How the figures look, and how they become files."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
import contextlib
from pathlib import Path
from typing import Any, Literal

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm
from matplotlib.figure import Figure
import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]

# Okabe and Ito's colours, which everybody can tell apart
BLACK = '#000000'
BLUE = '#0072b2'
ORANGE = '#e69f00'
GREEN = '#009e73'
RED = '#d55e00'
SKY = '#56b4e9'

WIDTH = 8.4
"""Of every figure: at 150 dots an inch it fills a page of GitHub, where letters are 9 pt. [in]"""

# Axes that several figures have
X_LABEL = '$x = L_s/(L_s+L_r)$'
C_LABEL = '$C = c_s/(L_s+L_r)f$'

PAPER: dict[str, Any] = {
    'color': RED,
    'marker': '*',
    'markersize': 14,
    'markeredgecolor': 'white',
    'linestyle': 'none',
    'zorder': 5,
}
"""How a number of the paper is marked."""

_SETTINGS: Any = {
    'axes.axisbelow': True,
    'axes.spines.right': False,
    'axes.spines.top': False,
    'axes.titlelocation': 'left',
    'axes.titlesize': 'medium',
    'font.size': 10.0,
    'legend.fontsize': 9.0,
    'legend.frameon': False,
    'lines.linewidth': 1.6,
    'mathtext.fontset': 'dejavusans',
    'savefig.dpi': 150,
}


@contextlib.contextmanager
def settings() -> Iterator[None]:
    """Have figures look the same in here, whatever the user has set."""
    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(_SETTINGS)
        yield


def new_figure(title: str, caption: str, *, height: float) -> Figure:
    """Make an empty figure with a title line, in bold, and a caption of a line or two."""
    figure = Figure(figsize=(WIDTH, height), layout='constrained')
    bold = title.replace(' ', r'\ ').replace(':', '{:}')
    figure.suptitle(
        rf'$\mathbf{{{bold}}}$' + f'\n{caption}',
        x=0.01,
        ha='left',
        fontsize='medium',
        linespacing=1.4,
    )
    return figure


def legend_below(figure: Figure, *axes: Axes, columns: int) -> None:
    """Put what is labelled in some axes below all of them, where it hides nothing."""
    labelled: dict[str, Any] = {}
    for part in axes:
        handles, labels = part.get_legend_handles_labels()
        labelled.update(zip(labels, handles, strict=True))
    figure.legend(
        list(labelled.values()), list(labelled), loc='outside lower center', ncols=columns
    )


def broken(values: ArrayLike) -> Floats:
    """Return a copy with NaN where it jumps, so that a line ends there and begins anew."""
    cut = np.array(values, dtype=np.float64)
    steps = np.abs(np.diff(cut))
    beside = np.lib.stride_tricks.sliding_window_view(np.pad(steps, 4, mode='edge'), 9)
    most = np.ptp(np.quantile(cut, (0.1, 0.9)))
    cut[1:][steps > 4.0 * np.median(beside, axis=1) + 2e-3 * most] = np.nan
    return cut


def show_map(
    axes: Axes,
    across: Floats,
    up: Floats,
    values: Floats,
    *,
    levels: Sequence[float] | Floats,
    colours: str,
    extend: Literal['neither', 'both', 'max'] = 'neither',
) -> Any:
    """Show values of shape (across, up) in bands of colour between levels."""
    half_x, half_y = 0.5 * (across[1] - across[0]), 0.5 * (up[1] - up[0])
    bands = mpl.colormaps[colours]
    return axes.imshow(
        values.T,
        origin='lower',
        aspect='auto',
        interpolation='nearest',
        extent=(across[0] - half_x, across[-1] + half_x, up[0] - half_y, up[-1] + half_y),
        cmap=bands,
        norm=BoundaryNorm(levels, bands.N, extend=extend),
    )


def save(figure: Figure, path: Path) -> None:
    """Write a figure as PNG, the same bytes every time."""
    with settings():
        # `Software` would name the version of matplotlib
        figure.savefig(path, metadata={'Software': None}, pil_kwargs={'optimize': True})
