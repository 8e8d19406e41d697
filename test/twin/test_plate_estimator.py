# SPDX-License-Identifier: Apache-2.0
"""Samples of a rig, from disorder to the motion of its plate."""

from __future__ import annotations

from dataclasses import replace
import math

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest
from soft_throw_ros.core.plate import Underdamped
from soft_throw_ros.core.smoothing import AHEAD, smooth
from soft_throw_ros.twin import journal
from soft_throw_ros.twin.plate_estimator import (
    Departure,
    first_states,
    FUTURE,
    Nodes,
    PAST,
    peak_speed,
    Sample,
    SECOND,
    time_since_start,
    Track,
    Tuning,
    Watch,
)

BEGIN = 1_700_000_000 * SECOND
PLATE = Underdamped(frequency=63.2, amplitude=2e-3, damping_ratio=0.064)
TUNING = Tuning(
    window_ns=2_000_000,
    wait_ns=0,
    position_noise=5e-6,
    velocity_noise=1e-2,
    start_speed=0.1 * PLATE.peak_velocity,
    band=5e-5,
    plate=PLATE,
)
INTERVAL = 200_000  # [ns]


def make_samples(count: int = 100, *, onset: float = math.inf, noise: float = 0.0) -> list[Sample]:
    """Measure a plate every 0.2 ms, at a height of 0.3 m before it starts, and a projectile."""
    random = np.random.default_rng(4)
    stamps = BEGIN + INTERVAL * np.arange(count)
    heights = 0.3 + PLATE.position((stamps - BEGIN) / SECOND - onset)
    heights += noise * random.standard_normal(count)
    return [
        Sample(stamp, height, math.nan, 0.5)
        for stamp, height in zip(stamps.tolist(), heights.tolist(), strict=True)
    ]


def run(track: Track, samples: list[Sample], *, batch: int = 5) -> Nodes:
    """Have a track take samples, and put together what it knows of the plate."""
    found = []
    for first in range(0, len(samples), batch):
        now_ns = max(sample.stamp_ns for sample in samples[: first + batch])
        track.take(samples[first : first + batch], now_ns)
        found.append(track.advance(now_ns))
    times, states, errors = (np.concatenate([nodes[k] for nodes in found]) for k in range(3))
    return Nodes(times, states, errors, max(nodes.gap for nodes in found))


def same(ours: Nodes, theirs: Nodes) -> bool:
    return [array.tobytes() for array in ours[:3]] == [array.tobytes() for array in theirs[:3]]


# order


def test_plate_is_smoothed_by_local_fits_an_eighth_of_the_window_apart():
    samples = make_samples(onset=0.01, noise=5e-6)
    nodes = run(Track(TUNING), samples)
    assert np.diff(nodes.times) == pytest.approx(0.25e-3, rel=1e-9)
    assert nodes.gap == pytest.approx(2e-4)
    fit = smooth(
        nodes.times,
        [(sample.stamp_ns - BEGIN) / SECOND for sample in samples],
        [sample.plate for sample in samples],
        window=2e-3,
        position_noise=5e-6,
    )
    assert nodes.states == pytest.approx(fit.states, rel=1e-9, abs=1e-9)
    assert nodes.errors == pytest.approx(fit.errors)


def test_plate_is_known_up_to_a_quarter_of_the_window_before_the_watermark():
    for wait_ns in (0, 1_000_000):
        track = Track(replace(TUNING, wait_ns=wait_ns))
        samples = make_samples()
        nodes = run(track, samples, batch=1)
        newest = (samples[-1].stamp_ns - BEGIN) / SECOND
        behind = newest - nodes.times[-1]
        least = AHEAD * TUNING.window + wait_ns / SECOND
        assert least <= behind < least + 0.25e-3


@given(
    seed=st.integers(0, 10_000),
    batch=st.integers(1, 30),
    doubled=st.sets(st.integers(0, 99), max_size=10),
)
def test_order_of_arrival_within_the_wait_changes_no_bit(seed, batch, doubled):
    tuning = replace(TUNING, wait_ns=2_000_000)
    samples = make_samples(onset=0.008, noise=5e-6)
    random = np.random.default_rng(seed)
    delays = random.uniform(0.0, tuning.wait_ns, len(samples))
    delays[0] = 0.0
    arrivals = np.array([sample.stamp_ns - BEGIN for sample in samples]) + delays
    order = np.argsort(arrivals).tolist()
    shuffled = [samples[k] for k in order]
    for k in doubled:
        shuffled.insert(shuffled.index(samples[k]) + 1, samples[k])
    ordered, mixed = Track(tuning), Track(tuning)
    assert same(run(ordered, samples), run(mixed, shuffled, batch=batch))
    assert mixed.refused == ({'doubled': len(doubled)} if doubled else {})
    assert ordered.refused == {}


def test_late_samples_are_refused_and_change_nothing():
    samples = make_samples(onset=0.01, noise=5e-6)
    late = samples.pop(50)
    without, with_late = Track(TUNING), Track(TUNING)
    expected = run(without, samples, batch=1)
    before = run(with_late, samples[:60], batch=1)
    assert with_late.take([late], samples[59].stamp_ns) == []
    after = run(with_late, samples[60:], batch=1)
    assert same(expected, Nodes(*map(np.concatenate, zip(before[:3], after[:3], strict=True))))
    assert with_late.refused == {'late': 1}


@pytest.mark.parametrize(
    ('sample', 'reason'),
    [
        (Sample(BEGIN, math.nan), 'not finite'),
        (Sample(BEGIN, math.inf), 'not finite'),
        (Sample(BEGIN, 0.0, math.inf), 'not finite'),
        (Sample(BEGIN, 0.0, 0.0, -math.inf), 'not finite'),
        (Sample(BEGIN, 100.1), 'out of range'),
        (Sample(BEGIN, 0.0, -1001.0), 'out of range'),
        (Sample(BEGIN, 0.0, 0.0, 1e300), 'out of range'),
        (Sample(BEGIN + FUTURE + 1, 0.0), 'future'),
        (Sample(BEGIN - PAST - 1, 0.0), 'past'),
        (Sample(0, 0.0), 'past'),
    ],
)
def test_bad_samples_are_refused_with_a_reason(sample, reason):
    track = Track(TUNING)
    assert track.take([sample], BEGIN) == []
    assert track.refused == {reason: 1}
    assert track.advance(BEGIN).times.size == 0


def test_missing_samples_are_bridged_and_the_gap_told():
    samples = make_samples(onset=0.005)
    whole = run(Track(TUNING), samples)
    samples = [sample for k, sample in enumerate(samples) if k % 3 and not 60 <= k < 66]
    nodes = run(Track(TUNING, origin_ns=BEGIN), samples)
    assert nodes.gap == pytest.approx(8 * INTERVAL / SECOND)
    shared = np.isin(whole.times, nodes.times)
    assert shared.sum() > 60
    late = whole.times[shared] > 0.008  # with the start out of the window
    assert nodes.states[np.isin(nodes.times, whole.times), 1][late] == pytest.approx(
        whole.states[shared, 1][late], abs=3e-3
    )


def test_gap_is_told_once_even_if_longer_than_the_window():
    samples = make_samples(200)
    del samples[80:140]
    track = Track(TUNING)
    gaps = []
    for sample in samples:
        track.take([sample], sample.stamp_ns)
        gaps.append(track.advance(sample.stamp_ns).gap)
    assert sum(gap > 1e-3 for gap in gaps) == 1
    assert max(gaps) == pytest.approx(61 * INTERVAL / SECOND)


def test_memory_does_not_grow():
    track = Track(TUNING)
    run(track, make_samples(5000))
    assert len(track.samples(0)) < 400
    later = BEGIN + 3600 * SECOND  # after an hour of nothing
    track.take([Sample(later, 0.3)], later)
    assert track.advance(later).times.size == 0


def test_velocities_that_were_measured_are_used():
    samples = make_samples(onset=0.004, noise=5e-6)
    since = [(sample.stamp_ns - BEGIN) / SECOND - 0.004 for sample in samples]
    exact = PLATE.velocity(since).tolist()
    both = [
        sample._replace(plate_velocity=speed) for sample, speed in zip(samples, exact, strict=True)
    ]
    errors = []
    for measured in (samples, both):
        nodes = run(Track(TUNING), measured)
        late = nodes.times > 0.008
        errors.append(np.std(nodes.states[late, 1] - PLATE.velocity(nodes.times[late] - 0.004)))
    assert errors[1] < 0.6 * errors[0]


def test_rate_is_that_of_most_samples():
    track = Track(TUNING)
    assert track.rate() == 0.0
    run(track, [sample for k, sample in enumerate(make_samples()) if k % 9])
    assert track.rate() == pytest.approx(5000.0)


@pytest.mark.parametrize(
    ('crossing_time', 'rate', 'reason'),
    [
        (1e-4, 30_000.0, '3 in a crossing of the wave'),
        (1e-2, 2000.0, '4 in measured.window'),
    ],
)
def test_least_rate_has_a_reason(crossing_time, rate, reason):
    assert TUNING.least_rate(crossing_time) == (pytest.approx(rate), reason)


def test_least_rate_resolves_the_period_of_the_plate():
    tuning = replace(TUNING, plate=replace(PLATE, frequency=200.0))
    assert tuning.least_rate(1e-2) == (pytest.approx(4000.0), '20 in a period of the plate')


# start


def watch_samples(samples: list[Sample]) -> tuple[Departure | None, int]:
    """Find the first departure, and how many samples that took."""
    track = Track(TUNING)
    watch = Watch(track)
    for count, sample in enumerate(samples, 1):
        track.take([sample], sample.stamp_ns)
        departure = watch.see(track.advance(sample.stamp_ns))
        if departure is not None:
            return departure, count
    return None, len(samples)


@pytest.mark.parametrize(('noise', 'accuracy'), [(0.0, 5e-6), (5e-6, 2e-5)])
@pytest.mark.parametrize('onset', [0.02, 0.0301234])
def test_start_is_found_soon_after_it(onset, noise, accuracy):
    departure, count = watch_samples(make_samples(400, onset=onset, noise=noise))
    assert departure is not None
    assert (departure.onset_ns - BEGIN) / SECOND == pytest.approx(onset, abs=accuracy)
    assert departure.plate_rest == pytest.approx(0.3, abs=2e-6)
    assert departure.projectile_rest == 0.5
    assert count * INTERVAL / SECOND < onset + 3.5e-3


def test_slow_motion_and_downward_jumps_start_nothing():
    samples = make_samples(1000)
    time = np.array([(sample.stamp_ns - BEGIN) / SECOND for sample in samples])
    creeping = 0.3 + 0.06 * np.maximum(time - 0.05, 0.0)
    falling = 0.3 - PLATE.position(time - 0.05) * (time < 0.05 + 0.9 * 0.5 / PLATE.frequency)
    for heights in (creeping, falling):
        moved = [
            sample._replace(plate=height)
            for sample, height in zip(samples, heights.tolist(), strict=True)
        ]
        assert watch_samples(moved)[0] is None


def test_start_without_a_rest_before_it_is_none():
    assert watch_samples(make_samples(400, onset=0.005))[0] is None


def test_start_after_a_gap_needs_another_rest():
    samples = make_samples(400, onset=0.04)
    assert watch_samples(samples)[0] is not None
    del samples[120:150]  # up to 10 ms before it
    assert watch_samples(samples)[0] is None


@given(
    zeta=st.floats(0.0, 0.99),
    share=st.floats(0.01, 0.8),
    amplitude=st.floats(1e-4, 1e-2),
)
def test_time_since_the_start_does_not_depend_on_the_amplitude(zeta, share, amplitude):
    plate = Underdamped(frequency=63.2, amplitude=amplitude, damping_ratio=zeta)
    since = share * plate.peak_velocity_time
    reference = replace(plate, amplitude=1.0)
    found = time_since_start(plate.position(since), plate.velocity(since), reference)
    assert found == pytest.approx(since, rel=1e-6)


def test_start_is_found_as_well_as_the_noise_allows():
    found = []
    for seed in range(100):
        noise = 5e-6 * np.random.default_rng(seed).standard_normal(400)
        samples = [
            sample._replace(plate=sample.plate + error)
            for sample, error in zip(make_samples(400, onset=0.025), noise.tolist(), strict=True)
        ]
        departure, _ = watch_samples(samples)
        assert departure is not None
        found.append((departure.onset_ns - BEGIN) / SECOND - 0.025)
    since = np.arange(0.0, 2.6e-3, 2e-4)
    sensitivity = np.column_stack((PLATE.velocity(since), PLATE.position(since)))
    bound = 5e-6 * math.sqrt(np.linalg.inv(sensitivity.T @ sensitivity)[0, 0])
    assert np.mean(found) == pytest.approx(0.0, abs=4e-6)
    assert np.std(found) < 1.5 * bound


def test_first_states_start_from_rest_with_a_jump_of_the_acceleration():
    departure, _ = watch_samples(make_samples(400, onset=0.02))
    assert departure is not None
    departure = replace(departure, onset_ns=BEGIN + SECOND // 50)
    times, states = first_states(departure, TUNING)
    assert times == pytest.approx(0.25e-3 * np.arange(6))
    assert states[:, 0] == pytest.approx(PLATE.position(times), abs=1e-12)
    assert states[:, 1] == pytest.approx(PLATE.velocity(times), abs=1e-8)
    start = PLATE.amplitude * (2.0 * math.pi * PLATE.frequency) ** 2
    assert states[0] == pytest.approx([0.0, 0.0, start])


def test_first_states_follow_a_plate_of_another_frequency():
    plate = replace(PLATE, frequency=70.0)
    since = 2e-4 * np.arange(1, 16)
    departure = Departure(
        onset_ns=BEGIN,
        plate_rest=0.0,
        projectile_rest=math.nan,
        samples=tuple(
            Sample(BEGIN + round(time * SECOND), height, speed)
            for time, height, speed in zip(
                since.tolist(),
                plate.position(since).tolist(),
                plate.velocity(since).tolist(),
                strict=True,
            )
        ),
    )
    times, states = first_states(departure, TUNING)
    assert states[:, 0] == pytest.approx(plate.position(times), abs=2e-6)
    assert states[:, 1] == pytest.approx(plate.velocity(times), abs=5e-3)


def test_peak_speed_is_that_without_the_noise():
    times = 2.5e-4 * np.arange(60)
    exact = PLATE.velocity(times)
    assert peak_speed(times, exact, 1.0 / 63.2) == pytest.approx(PLATE.peak_velocity, rel=1e-3)
    random = np.random.default_rng(5)
    found, largest = [], []
    for _ in range(200):
        noisy = exact + 7e-3 * random.standard_normal(times.size)
        found.append(peak_speed(times, noisy, 1.0 / 63.2))
        largest.append(noisy.max())
    assert np.mean(found) == pytest.approx(PLATE.peak_velocity, rel=3e-3)
    assert np.mean(largest) > 1.005 * PLATE.peak_velocity


def test_peak_speed_while_it_still_grows_is_the_last():
    times = 2.5e-4 * np.arange(10)
    assert peak_speed(times, PLATE.velocity(times), 1.0 / 63.2) == PLATE.velocity(times)[-1]


# in the journal

numbers = st.floats(allow_nan=False)


@given(
    batches=st.lists(
        st.tuples(
            st.integers(0, 2**40),
            st.lists(
                st.builds(Sample, st.integers(0, 2**62), numbers, numbers, numbers),
                min_size=1,
                max_size=5,
            ),
        ),
        min_size=1,
        max_size=6,
        unique_by=lambda batch: batch[0],
    ).map(sorted)
)
def test_samples_come_back_from_the_journal_to_the_last_bit(batches):
    last = batches[-1][0]
    line = journal.encode(journal.samples_entry(last, batches, first=3))
    entry = journal.decode(line)
    assert journal.entry_samples(entry) == batches
    assert entry['first'] == 3
    assert entry['count'] == sum(len(samples) for _, samples in batches)


def test_samples_take_a_third_less_than_their_numbers_as_text():
    samples = make_samples(1000, noise=5e-6)
    line = journal.encode(journal.samples_entry(0, [(0, samples)], first=0))
    text = ','.join(f'[{sample.stamp_ns},{sample.plate}]' for sample in samples)
    assert len(line) < 0.67 * len(text)


@pytest.mark.parametrize('projectile', [0.5, math.nan])
def test_departures_come_back_from_the_journal(projectile):
    departure = Departure(
        onset_ns=BEGIN, plate_rest=0.3, projectile_rest=projectile, samples=tuple(make_samples())
    )
    values = journal.decode(
        journal.encode({'kind': '', 'step': 0, **journal.departure_values(departure)})
    )
    again = journal.values_departure(values)
    assert repr(again) == repr(departure)


@pytest.mark.parametrize(
    ('change', 'complaint'),
    [
        ({'data': 'AAAA'}, 'no samples can be read'),
        ({'data': '?'}, 'no samples can be read'),
        ({'data': None}, 'no samples can be read'),
        ({'count': 2}, 'no samples can be read'),
        ({'count': None}, 'no samples can be read'),
        ({'step': 6}, r'samples are before 6, in order, got steps \[7\]'),
    ],
)
def test_damaged_samples_are_refused(change, complaint):
    entry = journal.samples_entry(7, [(7, make_samples(1))], first=0)
    with pytest.raises(journal.JournalError, match=complaint):
        journal.entry_samples({**entry, **change})


@pytest.mark.parametrize(
    ('values', 'complaint'),
    [
        (None, 'has its departure, got None'),
        ({}, "lacks 'onset_ns'"),
        ({'onset_ns': 0.5, 'plate_rest': 0.0, 'projectile_rest': None}, 'a time and heights'),
        ({'onset_ns': 5, 'plate_rest': None, 'projectile_rest': None}, 'a time and heights'),
        ({'onset_ns': 5, 'plate_rest': 0.0, 'projectile_rest': None}, 'no samples can be read'),
    ],
)
def test_damaged_departures_are_refused(values, complaint):
    with pytest.raises(journal.JournalError, match=complaint):
        journal.values_departure(values)
