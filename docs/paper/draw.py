# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Draw the figures of docs/paper.md and the README, and compute the tables of the page.

`python docs/paper/draw.py` writes all of them into docs; names (`fig3 page`) select some of them,
and `--output DIR` selects another folder.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from pathlib import Path

import fits
import limits
import maps
from matplotlib.figure import Figure
from page import update_page
import series
import style
import throws

DOCS = Path(__file__).resolve().parents[1]

PAGE = 'page'
"""Name that selects the tables of `paper.md`."""

ANIMATION = 'animation'
"""Name that selects the animated picture of the README."""

DRAWINGS: Mapping[str, Callable[[], Figure]] = {
    'throw': throws.draw_throw,
    'fig1': throws.draw_states,
    'fig2': throws.draw_traces,
    'fig3': maps.draw_maps,
    'fig4': maps.draw_best,
    'fig5': series.draw_series,
    'fig6': maps.draw_crossings,
    'recontacts': maps.draw_recontacts,
    'fig7': limits.draw_spring,
    'fig8': fits.draw_free_layers,
    'fig10': fits.draw_plate_fit,
    'fig11': maps.draw_damped_maps,
    'fig12': series.draw_damped_series,
    'thick_layer': limits.draw_thick_layer,
}
"""Functions that draw the figures; `throw` is the picture of the README."""


def path_of(name: str, folder: Path) -> Path:
    """Return the path of a figure, or of the page, below a folder such as docs."""
    if name == PAGE:
        return folder / 'paper.md'
    if name == ANIMATION:
        return folder / 'throw.gif'
    return folder / f'{name}.png' if name == 'throw' else folder / 'paper' / f'{name}.png'


def main(args: list[str] | None = None) -> int:
    """Draw the selected figures, by default all; return 0."""
    names = [*DRAWINGS, ANIMATION, PAGE]
    parser = argparse.ArgumentParser(description='Draw the figures and tables of docs/paper.md.')
    parser.add_argument('names', metavar='NAME', nargs='*',
                        help=f'one of {", ".join(names)} (default all)')
    parser.add_argument('--output', metavar='DIR', type=Path, default=DOCS, help='default docs')
    arguments = parser.parse_args(args)
    for name in arguments.names or names:
        if name not in names:
            parser.error(f'unknown name {name!r}; choose from {", ".join(names)}')
        path = path_of(name, arguments.output)
        path.parent.mkdir(parents=True, exist_ok=True)
        if name == PAGE:
            page = path_of(PAGE, DOCS).read_text(encoding='utf-8')
            path.write_text(update_page(page), encoding='utf-8')
        elif name == ANIMATION:
            throws.save_animation(path)
        else:
            with style.settings():
                style.save(DRAWINGS[name](), path)
        print(path, flush=True)
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
