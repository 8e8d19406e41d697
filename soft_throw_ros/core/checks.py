# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Checks of numbers, which raise a ValueError that quotes the bad number."""

from collections.abc import Callable
import math
from typing import Any

import numpy as np

_RANGES: dict[str, tuple[str, Callable[[Any], Any]]] = {
    'finite': ('finite', lambda numbers: numbers > -math.inf),
    'positive': ('finite and positive', lambda numbers: numbers > 0.0),
    'not_negative': ('finite and not negative', lambda numbers: numbers >= 0.0),
    'in_unit_interval': ('at least 0 and below 1', lambda x: (x >= 0.0) & (x < 1.0)),
}
"""Ranges of finite numbers by name: the rule in words, and as a function."""


def require_all(name: str, values: Any, kind: str) -> Any:
    """Return a number as a float, or numbers as an array, if all are in a range of `_RANGES`."""
    rule, is_allowed = _RANGES[kind]
    if type(values) is float and is_allowed(values) and values < math.inf:
        return values  # most are, and arrays take 20 times as long
    numbers = np.asarray(values)
    if numbers.dtype.kind not in 'fiu':
        raise ValueError(f'{name} must be a number, got {values!r}')
    numbers = numbers.astype(np.float64)
    is_good = is_allowed(numbers) & (numbers < math.inf)  # NaN fails every comparison
    if not is_good.all():
        raise ValueError(f'{name} must be {rule}, got {numbers[~is_good].flat[0]}')
    return numbers if numbers.ndim else float(numbers)
