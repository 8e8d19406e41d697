# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Sessions with a measured plate: samples, predictions and replay."""

from __future__ import annotations

from dataclasses import replace
import itertools
import math
from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from soft_throw_ros.core.plate import Underdamped
from soft_throw_ros.core.stepper import PROJECTILE_POSITION, PROJECTILE_VELOCITY
from soft_throw_ros.core.throw import simulate
from soft_throw_ros.nodes.conversions import comparison_text, throw_text
from soft_throw_ros.simulated_rig import imperfect_rig
from soft_throw_ros.simulated_rig.imperfect_rig import Imperfections
from soft_throw_ros.simulated_rig.sensor_faults import draw_chances, SensorFaults
from soft_throw_ros.storage.message import SECOND
from soft_throw_ros.twin.results import Phase
from soft_throw_ros.twin.session import RequestRejected
from twin_runs import measured_throw, Run, Sample, samples_of, states_at

ONSET = 0.0512345
MEASURED = {'engine__motion': 'measured'}


@pytest.fixture(scope='module')
def quiet() -> Any:
    """One throw, measured without noise."""
    run = Run(**MEASURED, measured__stamp_error=0.0)
    run.measure(duration=0.4, onset=ONSET)
    return run


# prediction


def test_predicted_release_agrees_with_the_release(quiet) -> None:
    exact = simulate(quiet.rig)
    assert quiet.phases()[:3] == [Phase.REST, Phase.CONTACT, Phase.FLIGHT]
    (first, certain), (release,) = quiet.results('predicted'), quiet.results('release')
    for result in (first, certain, release):
        tolerance = 0.01 if result is first else 1e-3
        assert result.first.ejection_time == pytest.approx(exact.ejection_time, rel=tolerance)
        assert result.first.ejection_speed == pytest.approx(exact.ejection_speed, rel=tolerance)
        assert result.peak_plate_speed == pytest.approx(exact.peak_plate_speed, rel=tolerance)
        assert result.first.energy_transfer == pytest.approx(exact.energy_transfer, rel=2e-3)
        assert result.peak_strain == pytest.approx(float(np.max(exact.loads.strain)), rel=0.02)
        begin_ns = quiet.begin_ns + ONSET * SECOND
        release_time = (result.first.release_ns - begin_ns) / SECOND
        tolerance = 2e-5 if result is first else 5e-6
        assert release_time == pytest.approx(exact.ejection_time, abs=tolerance)
    assert first.step < certain.step < release.step
    assert [item.accuracy.is_certain for item in (first, certain, release)] == [False, True, True]
    assert first.lead == release.lead
    assert certain.apex_height == pytest.approx(release.apex_height, rel=1e-3)
    assert certain.ended_by == ''


def test_projectile_follows_the_prediction_and_the_state_follows_the_rig(quiet) -> None:
    flying = [outputs for outputs in quiet.outputs if outputs.prediction][:20]
    predictions = [outputs.prediction for outputs in flying]
    times = [(item.stamp_ns - quiet.begin_ns) / SECOND - ONSET for item in predictions]
    position, velocity = states_at(quiet.rig, times).T[[PROJECTILE_POSITION, PROJECTILE_VELOCITY]]
    assert [item.position for item in predictions] == pytest.approx(position, abs=2e-6)
    assert [item.velocity for item in predictions] == pytest.approx(velocity, abs=3e-3)
    times = [1e-3 * outputs.step - ONSET for outputs in flying]
    states = [outputs.state for outputs in flying]
    position = states_at(quiet.rig, times).T[PROJECTILE_POSITION]
    assert [state.projectile_position for state in states] == pytest.approx(position, abs=2e-6)
    # The position of the plate is extrapolated over the last millisecond
    plate = Underdamped.of(quiet.rig.engine).position(times)
    assert [state.plate_position for state in states] == pytest.approx(plate, abs=5e-5)


def test_residual_without_noise_is_zero(quiet) -> None:
    residuals = [outputs.residual for outputs in quiet.outputs if outputs.residual]
    in_flight = [item for item in residuals if item.stamp_ns < quiet.begin_ns + 0.08 * SECOND]
    assert len(in_flight) > 20
    assert max(max(abs(item.projectile), abs(item.plate)) for item in in_flight) < 1e-6
    result = (quiet.results('final') or quiet.results('release'))[0]
    assert result.comparison.position_rms < 1e-6


def test_throw_field_agrees_with_the_throw(quiet) -> None:
    (field,) = (outputs.throw_field() for outputs in quiet.outputs if outputs.throw_field)
    exact = Run(throw__period=0.0)
    exact.session.request_throw()
    exact.go(60)
    (expected,) = (outputs.throw_field() for outputs in exact.outputs if outputs.throw_field)
    assert field.times == pytest.approx(expected.times, rel=2e-3)
    assert np.abs(field.strain - expected.strain).max() < 5e-3
    assert field.start_ns - quiet.begin_ns == pytest.approx(51_234_500, abs=2000)


@pytest.mark.parametrize(('factor', 'noise'), [(0.93, 5e-6), (0.97, 0.0)])
def test_deviations_of_an_aged_layer_exceed_the_threshold(factor, noise) -> None:
    run = Run(**MEASURED, measured__residual_threshold=5e-5)
    layer = replace(run.rig.layer, wave_speed=factor * run.rig.layer.wave_speed)
    other = replace(run.rig, layer=layer)
    run.measure(other, noise=noise)
    run.session.reset()
    run.go(3)
    (final,) = run.results('final')
    comparison = final.comparison
    assert not comparison.is_within_threshold
    assert comparison.threshold == 5e-5
    assert '50 um' in comparison_text(final)


# faults of the measurement


@pytest.mark.parametrize(('gap', 'is_valid'), [(2.4e6, False), (1.6e6, True)])
def test_gap_longer_than_a_crossing_makes_the_throw_invalid(gap, is_valid) -> None:
    run = Run(**MEASURED)
    first = run.begin_ns + SECOND // 20 + 4.0e6
    run.measure(change=lambda samples: [s for s in samples if not 0.0 <= s.stamp_ns - first < gap])
    if is_valid:
        (release,) = run.results('release')
        exact = simulate(run.rig)
        assert release.is_valid
        assert release.first.ejection_speed == pytest.approx(exact.ejection_speed, rel=0.01)
    else:
        (final,) = run.results('final')
        assert (final.ended_by, final.is_valid) == ('gap', False)
        assert 'throw 1' in throw_text(final)


def test_outliers_are_left_out_and_counted() -> None:
    run = Run(**MEASURED)
    samples = measured_throw(run.rig, begin_ns=run.begin_ns, noise=5e-6)
    for index in range(255, len(samples), 10):
        samples[index] = samples[index]._replace(plate=samples[index].plate + 1e-3)
    run.send(samples)
    run.receive()
    (release,), exact = run.results('release'), simulate(run.rig)
    assert release.accuracy.samples_left_out > 0.05 * release.accuracy.samples
    assert release.first.ejection_speed == pytest.approx(exact.ejection_speed, rel=5e-3)
    assert run.session.sample_counts.outliers >= 3


def test_throw_that_noise_may_release_is_invalid() -> None:
    run, random = Run(**MEASURED), np.random.default_rng(2)

    def scatter(samples: list[Sample]) -> list[Sample]:  # by twenty times of what is stated
        late = np.rint(2e5 * random.standard_normal(len(samples))).astype(int).tolist()
        return [s._replace(stamp_ns=s.stamp_ns + ns) for s, ns in zip(samples, late, strict=True)]

    for throw in (1, 2):
        run.measure(noise=5e-6, seed=throw + 1, duration=0.2, change=scatter)
        run.session.reset()
        run.go(3)
        final = run.results('final')[-1]
        assert (final.throw, final.ended_by, final.is_valid) == (throw, 'noise', False)
        values = final.values()
        assert not {'ejection_time', 'energy_transfer', 'accuracy.samples', 'lead'} & set(values)
        assert 'noisy' in throw_text(final)
    assert not run.results('release')


def test_release_shorter_than_the_error_of_its_time_is_noise() -> None:
    run, random = Run(**MEASURED, measured__stamp_error=8e-5), np.random.default_rng(99)
    onset = 0.05 + 1e-3 * random.uniform()
    errors = np.rint(8e4 * random.standard_normal(375)).astype(int).tolist()

    def scatter(samples: list[Sample]) -> list[Sample]:  # an early echo lifts it for 40 us
        pairs = zip(samples, errors, strict=True)
        return [sample._replace(stamp_ns=sample.stamp_ns + error) for sample, error in pairs]

    run.measure(noise=5e-6, seed=22, duration=0.075, onset=onset, change=scatter)
    assert {result.accuracy.is_certain for result in run.results('predicted')} == {False}
    run.session.reset()
    run.go(3)
    assert [result.ended_by for result in run.results('final')] == ['noise']


def trial(
    seed: int,
    *,
    rate: float = 5000.0,
    faults: dict[str, float] | None = None,
    second_mode: float = 0.0,
    **request: Any,
) -> tuple[float, list[Any]]:
    """
    Throw with an engine that differs from the settings within their uncertainties.

    Return the lead of the first prediction, and the deviations of the first and the last one from
    the truth, of time, speed and energy transfer, in standard errors.
    """
    random = np.random.default_rng(seed)
    run = Run(**MEASURED, **request)
    own = run.rig.engine
    frequency, damping = (
        run.settings[f'uncertainty.{name}'] * random.uniform(-1.0, 1.0)
        for name in ('frequency', 'damping_ratio')
    )
    own = replace(
        own,
        frequency=own.frequency + frequency,
        damping_ratio=abs(own.damping_ratio + damping),
        amplitude=own.amplitude * (1.0 + 0.03 * random.standard_normal()),
    )
    start, rig = 0.05 + random.uniform(0.0, 2e-3), replace(run.rig, engine=own)
    thrown = imperfect_rig.throw(rig, Imperfections(second_mode=second_mode), until=0.02)
    sensors = SensorFaults(**{'noise': 5e-6, 'jitter': 0.3 / rate, **(faults or {})})
    times = np.arange(0.0, start + 0.02, 1.0 / rate) - start
    chances = draw_chances(random, times.size)
    stamps, *heights, are_received = sensors.measure(
        times, thrown.plate, thrown.projectile, chances
    )
    stamps = run.begin_ns + np.rint((stamps + start) * SECOND).astype(np.int64)
    rows = zip(stamps.tolist(), *(height.tolist() for height in heights), strict=True)
    run.send(itertools.compress(map(Sample._make, rows), are_received))
    run.receive()
    for outputs in run.outputs:
        for result in outputs.results:  # certain is what no later motion of the plate can change
            if result.stage == 'predicted' and result.accuracy.is_certain:
                error_ns = result.accuracy.release_time_error * SECOND
                assert outputs.prediction.stamp_ns >= result.first.release_ns + error_ns - 1.0
    predictions, true = run.results('predicted'), thrown.events[0]
    fine = np.linspace(0.0, 0.012, 12001)
    alpha = (true.velocity / np.gradient(thrown.plate(fine), fine[1]).max()) ** 2
    deviations = []
    for result in (predictions[0], predictions[-1]):
        accuracy, release = result.accuracy, result.first
        late = (release.release_ns - run.begin_ns) / SECOND - start - true.time
        deviations.append([
            late / accuracy.release_time_error,
            (release.ejection_speed - true.velocity) / accuracy.ejection_speed_error,
            (release.energy_transfer - alpha) / accuracy.energy_transfer_error,
        ])
    return predictions[0].lead, deviations


@pytest.mark.parametrize(
    'row',
    [
        {'rate': 2500.0},
        {'faults': {'outlier_rate': 0.03, 'outlier_size': 1e-3, 'missing_rate': 0.05}},
        {'faults': {'stamp_error': 1.4e-4}, 'measured__stamp_error': 8e-5},
        {'second_mode': 0.01},
        {'layer__loss_tangent': 0.02},
        {'engine__motion_file': 'stroke.csv'},  # commanded
    ],
    ids=' '.join,
)
def test_errors_and_leads_of_predictions_hold(write, row) -> None:
    if 'engine__motion_file' in row:
        times = np.linspace(0.0, 0.03, 301)
        share = 2.0 * np.pi * np.minimum(times / 0.012, 1.0)
        rows = zip(times.tolist(), (7e-4 * (share - np.sin(share))).tolist(), strict=True)
        path = write('\n'.join(f'{time},{height}' for time, height in rows), 'stroke.csv')
        row = {'engine__motion_file': str(path)}
    leads, deviations = zip(*(trial(seed, **row) for seed in range(20)), strict=True)
    assert ((np.abs(deviations) < 2.0).mean(axis=(0, 1)) > 0.85).all()
    assert np.abs(deviations).max() < 6.0
    assert np.sqrt(np.square(deviations).mean(axis=(0, 1)))[1] > 0.1  # errors are not too large
    assert min(leads) > 1.5e-3


@pytest.mark.parametrize('factor', [1.0, 1.5])
def test_throw_lost_at_any_moment_ends_with_its_known_results(factor) -> None:
    exact = Run(**MEASURED).rig
    engine = replace(exact.engine, frequency=factor * exact.engine.frequency)
    rig = replace(exact, engine=engine)
    samples = measured_throw(rig, begin_ns=Run.begin_ns, noise=5e-6, duration=0.07)
    for count in (1, 8, 20, 30, 38):  # samples after the onset
        run = Run(**MEASURED)
        run.send(samples[: 250 + count])
        run.receive()
        run.go(1200)  # which is longer than samples may be late
        assert run.session.throws in (0, 1)
        assert [final.ended_by for final in run.results('final')] == ['gap'] * run.session.throws
        fields = [outputs.throw_field() for outputs in run.outputs if outputs.throw_field]
        assert len(fields) <= run.session.throws
    assert run.session.throws == 1


# from throw to throw


def test_next_jump_after_a_rest_starts_a_throw_with_pending_changes() -> None:
    run = Run(**MEASURED, layer__thickness=0.0095)
    run.measure(duration=0.15)
    run.session.change({'layer.thickness': 0.0168})
    assert run.session.pending == {'layer.thickness': 0.0168}
    run.measure(begin_ns=run.begin_ns + 150_000_000, onset=1.0, duration=0.05)
    run.measure(begin_ns=run.begin_ns + 200_000_000)
    stamps = [phase.stamp_ns for outputs in run.outputs for phase in outputs.phases]
    assert stamps == sorted(stamps)
    assert run.session.throws == 2
    thicknesses = [result.rig.layer.thickness for result in run.results('release')]
    assert thicknesses == [0.0095, 0.0168]
    assert run.session.pending == {}
    assert run.results('final')[0].ended_by in ('next', 'rest', 'max_events')


@pytest.mark.parametrize('is_under_way', [True, False])
def test_jump_applies_a_pending_motion(is_under_way) -> None:
    run = Run(**MEASURED, throw__period=0.0)
    run.measure()
    if not is_under_way:
        run.session.reset()
    run.measure(begin_ns=run.begin_ns + 120_000_000, onset=1.0, duration=0.04)
    throws = run.session.throws
    run.session.change({'engine.motion': 'underdamped'})
    run.measure()
    assert run.session.throws == throws
    assert not run.session.is_measured
    assert run.phases()[-1] is Phase.RETURNING
    run.go(200)
    assert run.phases()[-2:] == [Phase.RETURNING, Phase.REST]
    run.assert_repeated()


def test_plate_at_rest_is_shown_where_it_is_measured() -> None:
    run = Run(**MEASURED)
    run.measure(duration=0.2)
    run.session.reset()
    run.go(2)
    assert run.results('final')[0].ended_by == 'reset'
    state, rest = run.outputs[-1].state, run.outputs[0].state
    plate = float(Underdamped.of(run.rig.engine).position(0.15))
    assert state.plate_position == pytest.approx(plate, abs=2e-5)
    gap = rest.projectile_position
    assert state.projectile_position - state.plate_position == pytest.approx(gap)


def test_request_applies_a_pending_measurement_and_starts_no_throw() -> None:
    run = Run(throw__period=0.0)
    run.session.measure(samples_of([Sample(run.begin_ns, 0.0)]))  # without a listener
    run.session.change({'engine.motion': 'measured'})
    run.session.request_throw()
    run.measure()
    assert run.session.is_measured
    with pytest.raises(RequestRejected, match='measured'):
        run.session.request_throw()
    assert (run.session.throws, len(run.results('release'))) == (1, 1)
    run.assert_repeated()


# once more


CHANGES = st.fixed_dictionaries({}, optional={
    'plate': st.sampled_from([0.0, 0.3004, -50.0, 99.0, 1e300, math.nan, -math.inf]),
    'projectile': st.sampled_from([math.nan, 5.0, -99.0, math.inf]),
    'shift': st.integers(-(10**8), 10**8),
})


@settings(max_examples=15)
@given(
    loss=st.sampled_from([0.0, 0.02]),
    rate=st.sampled_from([2000.0, 5000.0, 20_000.0]),
    wait=st.sampled_from([0.0, 1e-3]),
    has_projectile=st.booleans(),
    changes=st.lists(st.tuples(st.floats(0.0, 1.0), CHANGES), max_size=40),
    gap=st.tuples(st.floats(0.0, 1.0), st.integers(0, 100)),
    throw=st.integers(0, 2),
)
def test_arbitrary_samples_are_followed_or_refused_and_replayed(
    loss, rate, wait, has_projectile, changes, gap, throw
) -> None:
    request = {'layer__loss_tangent': loss, 'measured__latency': wait}
    run = Run(**MEASURED, **request, rate__field=10.0 + 900e3 * wait)
    samples = measured_throw(
        run.rig, begin_ns=run.begin_ns, noise=5e-6, jitter=0.4, rate=rate
    )
    if not has_projectile:
        samples = [sample._replace(projectile=math.nan) for sample in samples]
    delays = np.random.default_rng(7).integers(0, 2_000_000, len(samples)).tolist()
    last = len(samples) - 1
    for share, values in changes:
        index = int(share * last)
        shift, heights = values.get('shift', 0), {k: v for k, v in values.items() if k != 'shift'}
        stamp_ns = samples[index].stamp_ns + shift
        samples[index] = samples[index]._replace(stamp_ns=stamp_ns, **heights)
        delays[index] -= shift
    lost = slice(int(gap[0] * last), int(gap[0] * last) + gap[1])
    del samples[lost], delays[lost]
    run.send(samples, delays)
    run.receive()
    run.go(10)
    counts = run.session.sample_counts
    assert counts.taken + sum(counts.refused.values()) == len(samples)
    assert all(math.isfinite(value) for outputs in run.outputs for value in outputs.state)
    run.session.reset()
    run.clock_offset_ns = 10**18
    run.measure(noise=5e-6)
    run.session.reset()
    run.go(3)
    assert run.results('final')[-1].clock_offset_ns == 10**18
    run.assert_repeated(throw if throw <= run.session.throws else 0)


def test_journal_of_samples_is_small_and_records_missing_samples() -> None:
    run = Run(**MEASURED)
    run.measure(duration=0.4)
    assert sum(map(len, run.journal)) < 25 * run.session.sample_counts.taken + 25_000
    silent = Run(**MEASURED)
    silent.go(450)
    entries = silent.entries('samples')
    assert [entry['step'] for entry in entries] == [100, 200, 300, 400]
    assert [entry['count'] for entry in entries] == [0] * 4
