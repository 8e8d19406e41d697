# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Samples of a rig in the order of their stamps."""

from __future__ import annotations

from bisect import bisect_left, insort

import numpy as np
import pytest
from soft_throw_ros.twin.sample_buffer import Sample, SampleBuffer, Samples
from soft_throw_ros.twin.tick_schedule import SECOND

BEGIN = 1_700_000_000 * SECOND


def to_list(samples: Samples) -> list[Sample]:
    rows = zip(samples.stamps.tolist(), samples.heights.tolist(), strict=True)
    return [Sample(stamp_ns, *heights) for stamp_ns, heights in rows]


@pytest.mark.parametrize('seed', range(3))
def test_buffer_agrees_with_a_sorted_list(seed) -> None:
    random = np.random.default_rng(seed)
    buffer, expected, newest = SampleBuffer(Samples.of([])), [], BEGIN
    for _ in range(1000):
        batch = []
        for _ in range(random.integers(0, 5)):
            newest += int(random.integers(1, 1000))
            late = int(random.integers(0, 5000)) if random.uniform() < 0.2 else 0
            sample = Sample(newest - late, float(random.uniform()), 0.5)
            if sample.stamp_ns not in {other.stamp_ns for other in expected[-50:]}:
                batch.append(sample)
                insort(expected, sample)
        buffer.add(Samples.of(batch))
        if random.uniform() < 0.1:
            oldest = newest - int(random.integers(100_000, 300_000))
            buffer.drop_before(oldest)
            del expected[: bisect_left(expected, (oldest,))]
        if random.uniform() < 0.05 and len(expected) > 20:
            first = len(expected) - 15
            marks = random.uniform(size=10) < 0.3
            buffer.remove(first, marks)
            pairs = zip(expected[first:], marks, strict=False)
            kept = [sample for sample, is_removed in pairs if not is_removed]
            expected[first:] = kept + expected[first + 10:]
        assert len(buffer) == len(expected)
    assert to_list(buffer.samples) == expected
    begin, end = expected[10].stamp_ns, expected[-10].stamp_ns
    assert to_list(buffer.between(begin, end)) == expected[10:-10]
    assert to_list(buffer.between(begin + 1)) == expected[11:]
