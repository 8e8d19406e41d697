# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Checks of numbers, which raise a ValueError that quotes the bad number."""

from collections.abc import Callable, Mapping
import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]


def require_finite(name: str, value: object) -> float:
    """Return a finite number as a float."""
    if isinstance(value, bool) or not isinstance(value, (int, float, np.integer, np.floating)):
        raise ValueError(f'{name} must be a number, got {value!r}')
    number = float(value)
    if not math.isfinite(number):
        raise ValueError(f'{name} must be finite, got {number}')
    return number


def require_positive(name: str, value: object) -> float:
    """Return a finite number above 0 as a float."""
    number = require_finite(name, value)
    if number <= 0.0:
        raise ValueError(f'{name} must be finite and positive, got {number}')
    return number


def require_not_negative(name: str, value: object) -> float:
    """Return a finite number that is at least 0 as a float."""
    number = require_finite(name, value)
    if number < 0.0:
        raise ValueError(f'{name} must be finite and not negative, got {number}')
    return number


def require_in_unit_interval(name: str, value: object) -> float:
    """Return a number in [0, 1) as a float."""
    number = require_finite(name, value)
    if not 0.0 <= number < 1.0:
        raise ValueError(f'{name} must be at least 0 and below 1, got {number}')
    return number


_RANGES: Mapping[str, tuple[str, Callable[[Floats], NDArray[np.bool_]]]] = {
    'finite': ('finite', lambda array: array > -math.inf),
    'positive': ('above 0 and finite', lambda array: array > 0.0),
    'not_negative': ('at least 0 and finite', lambda array: array >= 0.0),
    'in_unit_interval': ('at least 0 and below 1', lambda array: (array >= 0.0) & (array < 1.0)),
}
"""Ranges of finite numbers by name: the rule in words, and as a function."""


def require_all(name: str, values: ArrayLike, kind: str) -> Floats:
    """Return numbers as a float array if all are in a range; `kind` is a key of `_RANGES`."""
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f'{name} must be numbers, got {values!r}') from error
    rule, is_allowed = _RANGES[kind]
    is_good = is_allowed(array) & (array < math.inf)  # NaN fails every comparison
    if not is_good.all():
        raise ValueError(f'{name} must be {rule}, got {array[~is_good].flat[0]}')
    return array
