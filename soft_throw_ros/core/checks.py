# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Checks of numbers, which raise a ValueError that quotes the bad number."""

from collections.abc import Callable, Mapping
from functools import partial
import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

_RANGES: Mapping[str, tuple[str, Callable[[Any], Any]]] = {
    'finite': ('finite', lambda number: number > -math.inf),
    'positive': ('finite and positive', lambda number: number > 0.0),
    'not_negative': ('finite and not negative', lambda number: number >= 0.0),
    'in_unit_interval': (
        'at least 0 and below 1', lambda number: (number >= 0.0) & (number < 1.0)
    ),
}
"""Ranges of finite numbers by name: the rule in words, and as a function."""


def require_number(kind: str, name: str, value: object) -> float:
    """Return a number as a float if it is in a range; `kind` is a key of `_RANGES`."""
    if isinstance(value, bool) or not isinstance(value, (int, float, np.integer, np.floating)):
        raise ValueError(f'{name} must be a number, got {value!r}')
    number, (rule, is_allowed) = float(value), _RANGES[kind]
    if not (is_allowed(number) and number < math.inf):  # NaN fails every comparison
        raise ValueError(f'{name} must be {rule}, got {number}')
    return number


require_finite = partial(require_number, 'finite')
"""Return a finite number as a float."""

require_positive = partial(require_number, 'positive')
"""Return a finite number above 0 as a float."""

require_not_negative = partial(require_number, 'not_negative')
"""Return a finite number that is at least 0 as a float."""

require_in_unit_interval = partial(require_number, 'in_unit_interval')
"""Return a number in [0, 1) as a float."""


def require_all(name: str, values: ArrayLike, kind: str) -> NDArray[np.float64]:
    """Return numbers as a float array if all are in a range; `kind` is a key of `_RANGES`."""
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f'{name} must be numbers, got {values!r}') from error
    rule, is_allowed = _RANGES[kind]
    is_good = is_allowed(array) & (array < math.inf)
    if not is_good.all():
        raise ValueError(f'{name} must be {rule}, got {array[~is_good].flat[0]}')
    return array
