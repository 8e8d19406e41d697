# SPDX-License-Identifier: Apache-2.0
"""What can be drawn, without drawing it: that needs matplotlib."""

from __future__ import annotations

from collections.abc import Callable, Mapping
import importlib
from pathlib import Path
from typing import NamedTuple, TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class Drawing(NamedTuple):
    """A figure: where the function is that draws it, what it is called, what is to be seen."""

    name: str
    module: str
    function: str
    title: str
    text: str = ''

    @property
    def is_of_paper(self) -> bool:
        """Whether it is one of the paper's."""
        return self.name.startswith('fig')

    def path(self, kind: str) -> str:
        """Name its file, within the folder of all."""
        return f'paper/{self.name}.{kind}' if self.is_of_paper else f'{self.name}.{kind}'

    def draw(self) -> Figure:
        """
        Draw it.

        Raises
        ------
        ModuleNotFoundError
            If matplotlib is not installed.

        """
        from soft_throw_ros.commands.paper import style

        module = importlib.import_module(f'soft_throw_ros.commands.paper.{self.module}')
        make: Callable[[], Figure] = getattr(module, self.function)
        with style.settings():
            return make()

    def write(self, path: Path) -> None:
        """
        Draw it into a file, the same bytes every time.

        Parameters
        ----------
        path : Path
            Its ending is the format: png, pdf or svg.

        Raises
        ------
        ModuleNotFoundError
            If matplotlib is not installed.
        OSError
            If the file cannot be written.

        """
        from soft_throw_ros.commands.paper import style

        style.save(self.draw(), path)


DRAWINGS: Mapping[str, Drawing] = {
    drawing.name: drawing
    for drawing in (
        Drawing('throw', 'throws', 'draw_throw', 'A throw of the default rig'),
        Drawing(
            'fig1',
            'throws',
            'draw_states',
            'Fig. 1: what a throw looks like',
            'Two equal projectiles. The one on the bare plate leaves when that is fastest; the '
            'one on the layer starts later, and leaves later and faster. The layer is coloured '
            'by its strain.',
        ),
        Drawing(
            'fig2',
            'throws',
            'draw_traces',
            'Fig. 2: plate and projectile against time',
            'The same throw. Gray lines are whole crossings of the layer.',
        ),
        Drawing(
            'fig3',
            'series',
            'draw_series',
            'Fig. 3: the three series of throws',
            "With the rig's densities. Where thin layers touch the projectile again, the last "
            'release tends to what a bare plate does, the first to nothing. Times jump where the '
            'release passes an odd number of crossings.',
        ),
        Drawing(
            'fig4',
            'maps',
            'draw_maps',
            'Fig. 4: ejection time and energy transfer over all layers',
            'With equal densities, as in the paper. The optimum and the ridge are elsewhere on '
            "these axes for the rig's density ratio of 1.3, but not in mu and kappa.",
        ),
        Drawing(
            'fig5',
            'analysis',
            'draw_thick_layer',
            'Fig. 5: thick layers',
            'The projectile leaves before the wave is back, and omega tau alone decides.',
        ),
        Drawing(
            'fig6',
            'analysis',
            'draw_crossings',
            'Fig. 6: wave interval by wave interval',
            'The paper writes out the first two and stops at 5 t_s; the closed form goes on.',
        ),
        Drawing(
            'fig7',
            'analysis',
            'draw_spring',
            'Fig. 7: the massless spring',
            'What a layer is that is light beside the projectile. A heavier layer gives more.',
        ),
        Drawing(
            'fig11',
            'series',
            'draw_damped_series',
            'Fig. 11: the three series with the damped plate',
            'As Fig. 3 with the damping of the rig, and the largest strain of the layer. At '
            '63.2 Hz it is not "below 10 %".',
        ),
        Drawing(
            'fig12',
            'maps',
            'draw_damped_maps',
            'Fig. 12: all layers with the damped plate',
            'As Fig. 4 with the damping of the rig, and what that changes.',
        ),
    )
}
"""By name, in the order of the paper."""
