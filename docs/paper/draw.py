# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Draw the figures of docs/paper.md and the README by name, and compute the tables of the page."""

from __future__ import annotations

from pathlib import Path
import sys

from comparison import update_page
import fits
import maps
import series
import style
import throws

DOCS = Path(__file__).resolve().parents[1]

DRAWINGS = {
    'throw': throws.draw_throw,
    'fig1': throws.draw_states,
    'fig2': throws.draw_traces,
    'fig3': maps.draw_maps,
    'fig4': maps.draw_best,
    'fig5': series.draw_series,
    'fig6': maps.draw_crossings,
    'fig7': series.draw_spring,
    'fig8': fits.draw_free_layers,
    'fig10': fits.draw_plate_fit,
    'fig11': maps.draw_damped_maps,
    'fig12': series.draw_damped_series,
}
"""Functions that draw the figures; `throw` is the picture of the README."""


def main() -> None:
    """Draw the selected figures, by default all, or the tables of the page."""
    for name in sys.argv[1:] or [*DRAWINGS, 'animation', 'page']:
        if name == 'page':
            page = DOCS / 'paper.md'
            page.write_text(update_page(page.read_text('utf-8')), 'utf-8')
        elif name == 'animation':
            throws.save_animation(DOCS / 'throw.gif')
        else:
            folder = DOCS if name == 'throw' else DOCS / 'paper'
            with style.settings():
                style.save(DRAWINGS[name](), folder / f'{name}.png')
        print(name, flush=True)


if __name__ == '__main__':
    main()
