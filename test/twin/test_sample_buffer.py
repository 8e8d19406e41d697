# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Samples of a rig that arrive in any order, late, twice, or with impossible values."""

from __future__ import annotations

from dataclasses import replace
import math

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest
from soft_throw_ros.twin.sample_buffer import FUTURE, PAST, SampleBuffer, SampleCounts
from twin_runs import BEGIN, INTERVAL, make_samples, MEASUREMENT, Sample, samples_of


def run(buffer: SampleBuffer, samples: list[Sample], *, batch: int = 5) -> list[list[float]]:
    """Feed samples to a buffer in batches; return those that were completed, as rows."""
    completed = []
    for first in range(0, len(samples), batch):
        now_ns = max(sample.stamp_ns for sample in samples[: first + batch])
        buffer.add(samples_of(samples[first:first + batch]), now_ns)
        new = buffer.complete(now_ns)
        completed += np.column_stack((new.stamps, new.heights)).tolist()
    return completed


@given(
    seed=st.integers(0, 10_000),
    batch=st.integers(1, 30),
    doubled=st.sets(st.integers(0, 99), max_size=10),
)
def test_order_of_arrival_within_the_latency_changes_nothing(seed, batch, doubled) -> None:
    config = replace(MEASUREMENT, latency_ns=2_000_000)
    samples = make_samples(onset=0.008, noise=5e-6)
    samples[40] = samples[40]._replace(plate=0.31)
    samples[45] = samples[45]._replace(projectile=0.6)
    delays = np.random.default_rng(seed).uniform(0.0, config.latency_ns, len(samples))
    delays[0] = 0.0
    order = np.argsort([sample.stamp_ns - BEGIN for sample in samples] + delays).tolist()
    shuffled = [samples[k] for k in order]
    for k in doubled:
        shuffled.insert(shuffled.index(samples[k]) + 1, samples[k])
    ordered, mixed = (SampleBuffer(config, SampleCounts()) for _ in range(2))
    np.testing.assert_array_equal(run(ordered, samples), run(mixed, shuffled, batch=batch))
    assert mixed.counts.refused == ({'doubled': len(doubled)} if doubled else {})
    assert ordered.counts.refused == {}
    assert (ordered.outliers, ordered.counts.taken) == (2, 100)
    assert (np.diff(mixed.samples.stamps) > 0).all()
    begin, end = samples[50].stamp_ns, samples[60].stamp_ns
    assert ordered.between(begin, end).stamps.tolist() == list(range(begin, end, INTERVAL))
    assert math.isnan(ordered.between(samples[45].stamp_ns).projectile[0])


@pytest.mark.parametrize('since', [9, 10])  # samples; the tenth one completes the late one's time
def test_late_samples_are_refused_and_change_nothing(since) -> None:
    config = replace(MEASUREMENT, latency_ns=since * INTERVAL)
    samples = make_samples(noise=5e-6)
    late = samples.pop(50)
    without, with_late = (SampleBuffer(config, SampleCounts()) for _ in range(2))
    completed = run(with_late, samples[:60])
    assert not with_late.add(samples_of([late]), samples[59].stamp_ns)
    assert completed + run(with_late, samples[60:]) == run(without, samples)
    assert with_late.counts.refused == {'late': 1}


@pytest.mark.parametrize(
    ('sample', 'reason'),
    [
        (Sample(BEGIN, math.nan), 'not finite'),
        (Sample(BEGIN, math.inf), 'not finite'),
        (Sample(BEGIN, 0.0, -math.inf), 'not finite'),
        (Sample(BEGIN, 100.1), 'out of range'),
        (Sample(BEGIN, 0.0, 1e300), 'out of range'),
        (Sample(BEGIN + FUTURE + 1, 0.0), 'future'),
        (Sample(BEGIN - PAST - 1, 0.0), 'past'),
        (Sample(0, 0.0), 'past'),
    ],
)
def test_bad_samples_are_refused_with_a_reason(sample, reason) -> None:
    buffer = SampleBuffer(MEASUREMENT, SampleCounts())
    assert not buffer.add(samples_of([sample]), BEGIN)
    assert buffer.counts.refused == {reason: 1}
    assert not buffer.complete(BEGIN)


def test_old_samples_are_dropped_and_gaps_are_measured() -> None:
    samples = [sample for k, sample in enumerate(make_samples(1000)) if k % 5 and k < 996]
    buffer = SampleBuffer(MEASUREMENT, SampleCounts())
    run(buffer, samples, batch=7)
    assert buffer.gap == pytest.approx(4e-4)
    assert buffer.rate() == pytest.approx(5000.0)
    assert samples[-1].stamp_ns - buffer.samples.stamps[0] == pytest.approx(32e6, abs=INTERVAL)
    assert buffer.complete(samples[-1].stamp_ns).stamps.size == buffer.gap == 0
