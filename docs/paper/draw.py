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
"""
Draw the paper's figures, and write its numbers beside ours.

`python docs/paper/draw.py` writes `docs/paper.md`, its figures in `docs/paper`, and the README's
picture; names after it (`fig3 page`) choose some of them, `--output DIR` another folder.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
import importlib
from pathlib import Path
from typing import NamedTuple, TYPE_CHECKING

from page import write_page

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DOCS = Path(__file__).resolve().parents[1]

PAGE = 'page'
"""What is chosen for `paper.md`."""


class Drawing(NamedTuple):
    """A figure: the module and function that draw it, its heading, and what is to be seen."""

    module: str
    function: str
    title: str = ''
    text: str = ''

    def draw(self) -> Figure:
        """Draw it."""
        import style

        make: Callable[[], Figure] = getattr(importlib.import_module(self.module), self.function)
        with style.settings():
            return make()


DRAWINGS: Mapping[str, Drawing] = {
    'throw': Drawing('throws', 'draw_throw'),
    'fig1': Drawing(
        'throws',
        'draw_states',
        'Fig. 1: what a throw looks like',
        'Two equal projectiles. The one on the bare plate leaves when that is fastest. The one on '
        'the layer starts later, and leaves later and faster. Colours are strains of the layer.',
    ),
    'fig2': Drawing(
        'throws',
        'draw_traces',
        'Fig. 2: plate and projectile against time',
        'The same throw. Gray lines are whole crossings of the layer.',
    ),
    'fig3': Drawing(
        'maps',
        'draw_maps',
        'Fig. 3: ejection time and energy transfer over all layers',
        'With equal densities, as in the paper. The optimum and the ridge are elsewhere on these '
        "axes for the rig's density ratio of 1.3, but not in mu and kappa.",
    ),
    'fig4': Drawing(
        'maps',
        'draw_best',
        'Fig. 4: the best C and the largest alpha against x',
        'Small x is the massless spring, x = 1 the thick soft layer.',
    ),
    'fig5': Drawing(
        'series',
        'draw_series',
        'Fig. 5: the three series of throws',
        "With the rig's densities. Where thin layers touch the projectile again, the last release "
        'tends to what a bare plate does, the first to nothing. Times jump where the release '
        'passes an odd number of crossings.',
    ),
    'fig6': Drawing(
        'maps',
        'draw_crossings',
        'Fig. 6: wave interval by wave interval',
        'The paper shows maps over (x, C) with contours at whole t_e/t_s. Its analysis writes out '
        'the intervals up to 3 t_s and 5 t_s.',
    ),
    'recontacts': Drawing(
        'maps',
        'draw_recontacts',
        'Where re-contacts are',
        'Not a figure of the paper: its analysis leaves re-contacts out, its simulation has '
        'them. There are two regions: slow waves (up to C = 1.0 here, 1.3 with the densities of '
        'the rig, so within C < 2), and thin stiff layers. Traces are beside the lines '
        't_e = 3 t_s and 5 t_s, where the first release comes just before the echo.',
    ),
    'fig7': Drawing(
        'limits',
        'draw_spring',
        'Fig. 7: the massless spring',
        'What a layer is that is light beside the projectile. A heavier layer gives more.',
    ),
    'fig8': Drawing(
        'fits',
        'draw_free_layers',
        'Figs. 8 and 9: the period of free layers over their thickness',
        'The paper finds c_s from T_0 over L_s. The slope that it prints, a = 0.256, makes sense '
        'in s/m only: c_s = 2/a = 7.81 m/s. `soft-throw identify --free-layer` does the same with '
        'tracks and videos of your own.',
    ),
    'fig10': Drawing(
        'fits',
        'draw_plate_fit',
        'Fig. 10: the motion of the plate',
        'The fit finds what the track was made with, within its errors.',
    ),
    'fig11': Drawing(
        'maps',
        'draw_damped_maps',
        'Fig. 11: all layers with the damped plate',
        'As Fig. 3 with the damping of the rig, and what that changes.',
    ),
    'fig12': Drawing(
        'series',
        'draw_damped_series',
        'Fig. 12: the three series with the damped plate',
        'As Fig. 5 with the damping of the rig, and the largest strain of the layer. At 63.2 Hz '
        'it is not "below 10 %".',
    ),
    'thick_layer': Drawing(
        'limits',
        'draw_thick_layer',
        'App. C: thick layers',
        'The paper has no figure of this. The projectile leaves before the wave is back, and '
        'omega tau alone decides.',
    ),
}
"""By name, in the order of the page; the first is the README's picture."""


def path_of(name: str, folder: Path) -> Path:
    """Name the file of a drawing, or of the page, in a folder as `docs`."""
    if name == PAGE:
        return folder / 'paper.md'
    return folder / f'{name}.png' if name == 'throw' else folder / 'paper' / f'{name}.png'


def main(args: list[str] | None = None) -> int:
    """Draw what is asked for, all by default; return 0."""
    parser = argparse.ArgumentParser(description="Draw the paper's figures, and write its page.")
    parser.add_argument(
        'names', metavar='NAME', nargs='*', help=f'of {", ".join([*DRAWINGS, PAGE])} (default all)'
    )
    parser.add_argument('--output', metavar='DIR', type=Path, default=DOCS, help='default docs')
    arguments = parser.parse_args(args)
    for name in arguments.names or [*DRAWINGS, PAGE]:
        if name not in DRAWINGS and name != PAGE:
            parser.error(f'there is no {name!r}; there are: {", ".join([*DRAWINGS, PAGE])}')
        path = path_of(name, arguments.output)
        path.parent.mkdir(parents=True, exist_ok=True)
        if name == PAGE:
            path.write_text(write_page(_figures()), encoding='utf-8')
        else:
            import style

            style.save(DRAWINGS[name].draw(), path)
        print(path, flush=True)
    return 0


def _figures() -> str:
    """Write the headings, pictures and texts of the page."""
    return '\n'.join(
        f'## {drawing.title}\n\n![{drawing.title}](paper/{name}.png)\n\n{drawing.text}\n'
        for name, drawing in DRAWINGS.items()
        if drawing.title
    )


if __name__ == '__main__':
    raise SystemExit(main())
