# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The physics of one throw: rigs, the closed form, the steppers, and batches of throws.

Numbers in SI units go in, numbers come out; there is no clock, no file and no ROS. This package
imports the standard library, numpy, numba and SciPy only. The names below are for other code;
they are imported at their first use, because numba takes half a second.

"""

from typing import Any, TYPE_CHECKING

if TYPE_CHECKING:
    from soft_throw_ros.core.batch import ThrowUnresolvedError
    from soft_throw_ros.core.plate import SampledMotion
    from soft_throw_ros.core.rig import Engine, Layer, Projectile, Rig
    from soft_throw_ros.core.throw import simulate, Throw, throw_many, Throws

__all__ = [
    'Engine', 'Layer', 'Projectile', 'Rig', 'SampledMotion', 'Throw', 'ThrowUnresolvedError',
    'Throws', 'simulate', 'throw_many',
]


def __getattr__(name: str) -> Any:
    """Import one of the names of this package from its module."""
    if name in __all__:
        from soft_throw_ros.core import plate, rig, throw

        return next(vars(m)[name] for m in (plate, rig, throw) if name in vars(m))
    raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
