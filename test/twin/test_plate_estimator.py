# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Estimation of the plate's motion from unordered samples."""

from __future__ import annotations

from dataclasses import replace
import math

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest
from reference.smoothing import smooth
from soft_throw_ros.core.smoothing import AHEAD
from soft_throw_ros.twin.plate_estimator import (
    FUTURE,
    least_rate,
    PAST,
    PlateEstimator,
    PlateStates,
    SampleCounts,
    SampledSpan,
)
from soft_throw_ros.twin.sample_buffer import Sample, Samples
from soft_throw_ros.twin.tick_schedule import SECOND
from twin_runs import BEGIN, INTERVAL, make_samples, MEASUREMENT


def run(estimator: PlateEstimator, samples: list[Sample], *, batch: int = 5) -> PlateStates:
    """Feed samples to an estimator in batches and return all its states of the plate."""
    motions = []
    for first in range(0, len(samples), batch):
        now_ns = max(sample.stamp_ns for sample in samples[: first + batch])
        estimator.add_samples(Samples.of(samples[first:first + batch]), now_ns)
        motions.append(estimator.advance(now_ns))
    times, states, errors = (np.concatenate([motion[k] for motion in motions]) for k in range(3))
    return PlateStates(times, states, errors, max(motion.gap for motion in motions))


def same(ours: PlateStates, theirs: PlateStates) -> bool:
    return [array.tobytes() for array in ours[:3]] == [array.tobytes() for array in theirs[:3]]


def test_plate_is_smoothed_by_local_fits_at_eighths_of_the_window() -> None:
    samples = make_samples(onset=0.01, noise=5e-6)
    motion = run(PlateEstimator(MEASUREMENT, SampleCounts()), samples)
    assert np.diff(motion.times) == pytest.approx(0.25e-3, rel=1e-9)
    assert motion.gap == pytest.approx(2e-4)
    fit = smooth(
        motion.times,
        [(sample.stamp_ns - BEGIN) / SECOND for sample in samples],
        [sample.plate for sample in samples],
        window=2e-3,
        position_noise=5e-6,
    )
    assert motion.states == pytest.approx(fit.states, rel=1e-9, abs=1e-9)
    assert motion.errors == pytest.approx(fit.errors)


def test_plate_is_known_up_to_a_quarter_of_the_window_before_the_watermark() -> None:
    for latency_ns in (0, 1_000_000):
        estimator = PlateEstimator(
            replace(MEASUREMENT, latency_ns=latency_ns), SampleCounts()
        )
        samples = make_samples()
        motion = run(estimator, samples, batch=1)
        newest = (samples[-1].stamp_ns - BEGIN) / SECOND
        behind = newest - motion.times[-1]
        least = AHEAD * MEASUREMENT.smoothing_window + latency_ns / SECOND
        assert least <= behind < least + 0.25e-3


@given(
    seed=st.integers(0, 10_000),
    batch=st.integers(1, 30),
    doubled=st.sets(st.integers(0, 99), max_size=10),
)
def test_order_of_arrival_within_the_latency_changes_no_bit(seed, batch, doubled) -> None:
    config = replace(MEASUREMENT, latency_ns=2_000_000)
    samples = make_samples(onset=0.008, noise=5e-6)
    random = np.random.default_rng(seed)
    delays = random.uniform(0.0, config.latency_ns, len(samples))
    delays[0] = 0.0
    arrivals = np.array([sample.stamp_ns - BEGIN for sample in samples]) + delays
    order = np.argsort(arrivals).tolist()
    shuffled = [samples[k] for k in order]
    for k in doubled:
        shuffled.insert(shuffled.index(samples[k]) + 1, samples[k])
    ordered, mixed = (PlateEstimator(config, SampleCounts()) for _ in range(2))
    assert same(run(ordered, samples), run(mixed, shuffled, batch=batch))
    assert mixed.counts.refused == ({'doubled': len(doubled)} if doubled else {})
    assert ordered.counts.refused == {}


def test_late_samples_are_refused_and_change_nothing() -> None:
    samples = make_samples(onset=0.01, noise=5e-6)
    late = samples.pop(50)
    without, with_late = (
        PlateEstimator(MEASUREMENT, SampleCounts()) for _ in range(2)
    )
    expected = run(without, samples, batch=1)
    before = run(with_late, samples[:60], batch=1)
    assert not with_late.add_samples(Samples.of([late]), samples[59].stamp_ns)
    after = run(with_late, samples[60:], batch=1)
    assert same(
        expected, PlateStates(*map(np.concatenate, zip(before[:3], after[:3], strict=True)))
    )
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
    estimator = PlateEstimator(MEASUREMENT, SampleCounts())
    assert not estimator.add_samples(Samples.of([sample]), BEGIN)
    assert estimator.counts.refused == {reason: 1}
    assert estimator.advance(BEGIN).times.size == 0


def test_missing_samples_are_bridged_and_the_gap_is_reported() -> None:
    samples = make_samples(onset=0.005)
    whole = run(PlateEstimator(MEASUREMENT, SampleCounts()), samples)
    samples = [sample for k, sample in enumerate(samples) if k % 3 and not 60 <= k < 66]
    motion = run(PlateEstimator(MEASUREMENT, SampleCounts(), origin_ns=BEGIN), samples)
    assert motion.gap == pytest.approx(8 * INTERVAL / SECOND)
    shared = np.isin(whole.times, motion.times)
    assert shared.sum() > 60
    late = whole.times[shared] > 0.008  # with the start out of the window
    assert motion.states[np.isin(motion.times, whole.times), 1][late] == pytest.approx(
        whole.states[shared, 1][late], abs=3e-3
    )


@pytest.mark.parametrize(
    ('frequency', 'crossing_time', 'rate', 'span'),
    [
        (63.2, 1e-4, 30_000.0, SampledSpan.CROSSING),
        (63.2, 1e-2, 2000.0, SampledSpan.WINDOW),
        (200.0, 1e-2, 4000.0, SampledSpan.PERIOD),
    ],
)
def test_minimum_rate_has_a_reason(frequency, crossing_time, rate, span) -> None:
    plate = replace(MEASUREMENT.plate, frequency=frequency)
    measurement = replace(MEASUREMENT, plate=plate)
    assert least_rate(measurement, crossing_time) == (pytest.approx(rate), span)
