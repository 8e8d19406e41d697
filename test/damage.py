# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Strategies of hypothesis that damage valid input; a parser reads the result or refuses it."""

from __future__ import annotations

from collections.abc import Callable
import math
import re
import struct
from typing import Any, TypeVar

from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st

NUMBERS = [
    'nan', '.nan', 'inf', '-.inf', '1e400', '1e308', '5e-324', '-0.0', '0', '1e-3', '1', '-1',
    '0x1F', '1_000', '١', '1,5', '9' * 400, '18446744073709551616',
]
WORDS = [
    *NUMBERS, '', ' ', '\t', '\n', '\r', '\0', '\ufeff', ':', '- ', '? ', '#', ',', ';', '[' * 300,
    '{a: ' * 300, '&a ', '*a', '<<: *a', '!!python/object/apply:os.system [exit 1]', '---\n', '"',
    '%', 'null', 'true', '2026-11-22', '../', '**', '\u2028', 'a' * 3000, ':=', '+-',
]
_RAW_NUMBERS = [
    *(struct.pack('<I', number) for number in (0, 1, 2**28, 2**32 - 1)),
    *(struct.pack('<Q', number) for number in (0, 2**32, 2**63, 2**64 - 1)),
    *(struct.pack('<d', number) for number in (math.nan, math.inf, 1e308)),
]

few = settings(
    max_examples=50,
    phases=(Phase.explicit, Phase.generate),  # shrinking a bag takes minutes
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
"""Decorator of a property test whose examples overwrite the same files."""

Result = TypeVar('Result')


def accepted(read: Callable[[], Result], *words: str) -> Result | None:
    """Return the result of a parser, or None after a ValueError of one line with the words."""
    try:
        return read()
    except ValueError as error:
        line = str(error)
    assert line.strip()
    assert '\n' not in line
    assert all(word in line for word in words), line
    return None


@st.composite
def texts(draw: Callable[..., Any], *valid: str) -> str:
    """Return a valid text with other numbers, and parts replaced by words or doubled."""
    text: str = draw(st.sampled_from(valid))
    for _ in range(draw(st.integers(0, 3))):
        numbers = list(re.finditer(r'-?\d[\d.]*(?:e-?\d+)?', text))
        if numbers and draw(st.booleans()):
            begin, end = draw(st.sampled_from(numbers)).span()
            put = draw(st.sampled_from(NUMBERS) | st.floats().map(repr))
        else:
            begin = draw(st.integers(0, len(text)))
            end = min(len(text), begin + draw(st.sampled_from([0, 1, 4, 12, 200])))
            put = draw(st.sampled_from([*WORDS, text[begin:end] * 2]) | st.text(max_size=5))
        text = text[:begin] + put + text[end:]
    return text


@st.composite
def datas(draw: Callable[..., Any], *valid: bytes) -> bytes:
    """Return valid data with flipped bits, other numbers, and parts cut off or doubled."""
    data = bytearray(draw(st.sampled_from(valid)))
    for _ in range(draw(st.integers(1, 3))):
        begin = draw(st.integers(0, len(data)))
        if begin < len(data) and draw(st.booleans()):
            data[begin] ^= 1 << draw(st.integers(0, 7))
        else:
            end = begin + draw(st.sampled_from([1, 4, 8, 64, len(data)]))
            put = draw(st.sampled_from([b'', bytes(data[begin:end]) * 2, *_RAW_NUMBERS]))
            data[begin:end] = put
    return bytes(data)
