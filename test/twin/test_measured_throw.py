# SPDX-License-Identifier: Apache-2.0
"""Throws of a measured plate, in the session: samples in, predictions out, and once more."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
import itertools
import math
from pathlib import Path
import runpy
from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from soft_throw_ros.configuration import rig_of, TWIN
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.core.stepper import Stepper
from soft_throw_ros.core.stepping import PROJECTILE_POSITION, PROJECTILE_VELOCITY
from soft_throw_ros.core.throw import simulate
from soft_throw_ros.twin import journal
from soft_throw_ros.twin.plate_estimator import Sample, SECOND
from soft_throw_ros.twin.tick_schedule import TickSchedule
from soft_throw_ros.twin.plan import check
from soft_throw_ros.twin.results import Outputs, Phase, ThrowResult
from soft_throw_ros.twin.replay import apply_input, replay
from soft_throw_ros.twin.session import RequestRejected, Session

rigs: Any = runpy.run_path(str(Path(__file__).with_name('rigs.py')))
aged, measured_throw, plate_of = (rigs[name] for name in ('aged', 'measured_throw', 'plate_of'))

BEGIN = 1_700_000_000 * SECOND
TRANSPORT = 150_000  # [ns]


class Run:
    """A session with a measured plate, its journal, and all that came out."""

    def __init__(self, **request: Any) -> None:
        self.journal: list[str] = []
        self.outputs: list[Outputs] = []
        named = {name.replace('__', '.'): value for name, value in request.items()}
        named = {'engine.motion': 'measured', **named}
        self.settings = {**TWIN.defaults(), **TWIN.change(TWIN.defaults(), named)}
        self.rig = rig_of(self.settings)
        self.session = Session(self.settings, on_entry=self.journal.append)
        self.session.set_tick_schedule(
            TickSchedule(step=0, time_ns=BEGIN, rate=self.settings['rate.state'])
        )
        self._waiting: list[tuple[int, Sample]] = []

    def send(self, samples: Iterable[Sample], delays: Sequence[int] = ()) -> None:
        """Have samples arrive so much after their stamps."""
        for sample, delay in itertools.zip_longest(samples, delays, fillvalue=TRANSPORT):
            self._waiting.append((sample.stamp_ns + delay, sample))
        self._waiting.sort(key=lambda item: item[0])

    def throw(self, rig: Any = None, **kwargs: Any) -> None:
        """Have the rig throw, and go on to the end of the samples."""
        kwargs.setdefault('begin_ns', BEGIN + SECOND // 1000 * self.session.step)
        self.send(measured_throw(rig or self.rig, **kwargs))
        self.go_on()

    def go_on(self, steps: int = 0) -> None:
        """Go on until all samples have come, and some steps further."""
        period = round(SECOND / self.settings['rate.state'])
        while self._waiting or steps > 0:
            steps -= not self._waiting
            now_ns = BEGIN + self.session.step * period
            count = sum(arrival <= now_ns for arrival, _ in self._waiting)
            self.session.measure([sample for _, sample in self._waiting[:count]])
            del self._waiting[:count]
            self.outputs.append(self.session.advance())

    def results(self, stage: str) -> list[ThrowResult]:
        return [
            result
            for outputs in self.outputs
            for result in outputs.results
            if result.stage == stage
        ]

    def phases(self) -> list[Phase]:
        return [phase for outputs in self.outputs for phase in outputs.phases]

    def notices(self) -> list[str]:
        return [notice for outputs in self.outputs for notice in outputs.notices]

    def repeat(self, throw: int = 0) -> list[Outputs]:
        self.session.close()
        return list(replay(self.journal, until=self.session.step, throw=throw))


def follow(rig: Any, times: Sequence[float]) -> np.ndarray:
    """Return position and velocity of the projectile of a rig of its own."""
    model = Stepper(rig)
    rows = []
    for time in times:
        model.advance_to(max(time, 0.0))
        rows.append(model.state[[PROJECTILE_POSITION, PROJECTILE_VELOCITY]].copy())
    return np.array(rows)


def bits(outputs: Outputs) -> list[Any]:
    """Return what can be compared, bit for bit."""
    fields = [outputs.layer, outputs.throw_field]
    return [
        repr(outputs[:6]),
        *([array.tobytes() for array in field or ()] for field in fields),
        repr(outputs[8:]),
    ]


@pytest.fixture(scope='module')
def quiet() -> Run:
    """One throw, measured without noise."""
    run = Run()
    run.throw(duration=0.4, onset=0.0512345)
    return run


# prediction


def test_throw_starts_with_the_plate(quiet) -> None:
    assert quiet.phases()[:3] == [Phase.REST, Phase.CONTACT, Phase.FLIGHT]
    entry = next(entry for entry in map(journal.decode, quiet.journal) if entry['kind'] == 'throw')
    onset_ns = entry['departure']['onset_ns']
    assert onset_ns - BEGIN == pytest.approx(51_234_500, abs=2000)
    start = next(outputs.step for outputs in quiet.outputs if Phase.CONTACT in outputs.phases)
    assert start <= 55  # nothing is lost, though it is seen after 3 ms


def test_release_is_predicted_as_it_is(quiet) -> None:
    exact = simulate(quiet.rig)
    (predicted,), (release,) = quiet.results('predicted'), quiet.results('release')
    for result in (predicted, release):
        assert result.first is not None
        assert result.first.time == pytest.approx(exact.ejection_time, abs=1e-5)
        assert result.first.speed == pytest.approx(exact.ejection_speed, rel=1e-3)
        assert result.peak_plate_speed == pytest.approx(
            plate_of(quiet.rig).peak_velocity, rel=1e-3
        )
        assert result.first.energy_transfer == pytest.approx(exact.energy_transfer, rel=2e-3)
        assert result.peak_strain == pytest.approx(float(np.max(exact.peak_strain)), rel=0.02)
    assert predicted.step < release.step
    assert predicted.lead == release.lead
    assert predicted.apex_height == pytest.approx(release.apex_height, rel=1e-3)
    assert predicted.ended_by == ''


def test_lead_is_the_crossing_time_less_filter_and_transport(quiet) -> None:
    crossing = quiet.rig.crossing_time
    leads = [outputs.prediction.lead_ns for outputs in quiet.outputs if outputs.prediction]
    latest = 0.5e-3 + 0.25e-3 + 0.2e-3 + 0.15e-3 + 0.05e-3  # window, nodes, sample, transport
    assert crossing - latest < min(leads) / SECOND <= max(leads) / SECOND < crossing - 0.5e-3
    (predicted,) = quiet.results('predicted')
    assert predicted.lead is not None
    assert 0.0 < predicted.lead < max(leads) / SECOND
    assert predicted.is_ahead
    assert predicted.lead_sentence() == f'known {1e3 * predicted.lead:.2f} ms before'


def test_projectile_is_predicted_where_it_will_be(quiet) -> None:
    predictions = [outputs.prediction for outputs in quiet.outputs if outputs.prediction][:20]
    times = [(item.stamp_ns - BEGIN) / SECOND - 0.0512345 for item in predictions]
    position, velocity = follow(quiet.rig, times).T
    assert [item.position for item in predictions] == pytest.approx(position, abs=2e-6)
    assert [item.velocity for item in predictions] == pytest.approx(velocity, abs=3e-3)


def test_state_at_the_tick_is_that_of_the_rig(quiet) -> None:
    flying = [outputs for outputs in quiet.outputs if outputs.prediction][:20]
    times = [1e-3 * outputs.step - 0.0512345 for outputs in flying]
    position, _ = follow(quiet.rig, times).T
    states = [outputs.state for outputs in flying]
    assert [state.projectile_position for state in states] == pytest.approx(position, abs=2e-6)
    # what the last millisecond has brought is extrapolated
    plate = plate_of(quiet.rig).position(times)
    assert [state.plate_position for state in states] == pytest.approx(plate, abs=5e-5)


def test_residual_without_noise_is_none(quiet) -> None:
    residuals = [outputs.residual for outputs in quiet.outputs if outputs.residual]
    aloft = [item for item in residuals if item.stamp_ns < BEGIN + 0.08 * SECOND]
    assert len(aloft) > 20
    assert max(abs(item.projectile) for item in aloft) < 1e-6
    assert max(abs(item.plate) for item in aloft) < 1e-6
    (final,) = quiet.results('final') or quiet.results('release')
    assert final.comparison is not None
    assert final.comparison.position_rms < 1e-6


def test_throw_field_is_that_of_the_throw(quiet) -> None:
    (field,) = (outputs.throw_field for outputs in quiet.outputs if outputs.throw_field)
    exact = Run(engine__motion='underdamped', throw__period=0.0)
    exact.session.request_throw()
    exact.go_on(60)
    (expected,) = (outputs.throw_field for outputs in exact.outputs if outputs.throw_field)
    assert field.times == pytest.approx(expected.times, rel=2e-3)
    assert field.strain.shape == expected.strain.shape
    assert np.abs(field.strain - expected.strain).max() < 5e-3


@pytest.mark.parametrize('seed', range(4))
def test_noise_and_jitter_leave_the_release_to_a_percent(seed) -> None:
    run = Run(layer__name='gelatin_29.1mm')
    run.throw(noise=5e-6, jitter=0.3, seed=seed, onset=0.0501)
    exact = simulate(run.rig)
    (predicted,) = run.results('predicted')
    assert predicted.first is not None
    assert predicted.first.speed == pytest.approx(exact.ejection_speed, rel=0.01)
    assert predicted.first.time == pytest.approx(exact.ejection_time, rel=0.01)
    assert predicted.lead is not None
    assert predicted.lead > 0.25 * run.rig.crossing_time


@pytest.mark.parametrize(
    ('model', 'loss', 'is_ahead'),
    [
        ('finite_difference', 0.0, True),
        ('finite_difference', 0.02, True),
        ('finite_difference_elastic', 0.0, True),
        ('finite_difference_glued', 0.0, False),  # it leaves at the plate
        ('spring_mass', 0.0, False),  # waves need no time
    ],
)
def test_other_models_are_as_far_ahead_as_their_waves(model, loss, is_ahead) -> None:
    run = Run(model=model, layer__loss_tangent=loss)
    run.throw(Rig())
    theirs = Run(
        model=model, layer__loss_tangent=loss, engine__motion='underdamped', throw__period=0.0
    )
    theirs.session.request_throw()
    theirs.go_on(60)
    (predicted,), (expected,) = run.results('predicted'), theirs.results('release')
    assert predicted.first is not None
    assert expected.first is not None
    assert predicted.first.time == pytest.approx(expected.first.time, rel=2e-3)
    assert predicted.first.speed == pytest.approx(expected.first.speed, rel=2e-3)
    assert predicted.is_ahead == is_ahead
    if not is_ahead:
        assert 'too late' in predicted.lead_sentence()


def test_without_a_projectile_there_is_no_residual() -> None:
    run = Run()
    run.throw(has_projectile=False)
    assert not any(outputs.residual for outputs in run.outputs)
    (release,) = run.results('release')
    assert release.comparison is None


def test_layer_that_has_aged_leaves_the_band() -> None:
    run = Run()
    run.throw(aged(run.rig, 0.93), noise=5e-6)
    run.session.reset()
    run.go_on(3)
    (final,) = run.results('final')
    comparison = final.comparison
    assert comparison is not None
    assert not comparison.is_within_band
    assert 'the layer has aged' in comparison.describe()
    ours, theirs = simulate(run.rig), simulate(aged(run.rig, 0.93))
    assert comparison.ejection_speed_error == pytest.approx(
        ours.ejection_speed - theirs.ejection_speed, rel=0.15
    )


def test_error_of_the_ejection_time_is_that_at_the_height_of_the_release() -> None:
    run = Run()
    run.throw(aged(run.rig, 0.97))
    run.session.reset()
    run.go_on(3)
    (final,) = run.results('final')
    assert final.comparison is not None
    ours = simulate(run.rig)
    start, end = follow(run.rig, [0.0, ours.ejection_time])[:, 0]
    times = np.linspace(0.5, 1.5, 20001) * ours.ejection_time
    track, speeds = follow(aged(run.rig, 0.97), [0.0, *times]).T
    passed = np.searchsorted(track[1:] - track[0], end - start)
    assert final.comparison.ejection_time_error == pytest.approx(
        ours.ejection_time - times[passed], abs=5e-6
    )
    assert final.comparison.ejection_speed_error == pytest.approx(
        ours.ejection_speed - speeds[1:][passed], abs=1e-3
    )


# what goes wrong


def test_gap_makes_the_throw_invalid() -> None:
    run = Run()
    samples = measured_throw(run.rig, begin_ns=BEGIN)
    onset = BEGIN + SECOND // 20
    run.send(sample for sample in samples if not 4.0e6 <= sample.stamp_ns - onset < 4.0e6 + 2.4e6)
    run.go_on()
    (final,) = run.results('final')
    assert final.ended_by == 'gap'
    assert not final.is_valid
    assert final.describe() == 'throw 1 is invalid: the plate was not measured for too long'


def test_gap_shorter_than_a_crossing_is_bridged() -> None:
    run = Run()
    samples = measured_throw(run.rig, begin_ns=BEGIN)
    onset = BEGIN + SECOND // 20
    run.send(sample for sample in samples if not 4.0e6 <= sample.stamp_ns - onset < 4.0e6 + 1.6e6)
    run.go_on()
    (release,) = run.results('release')
    assert release.is_valid
    assert release.first is not None
    assert release.first.speed == pytest.approx(simulate(run.rig).ejection_speed, rel=0.01)


def test_plate_that_is_not_measured_any_more_is_lost() -> None:
    run = Run()
    run.throw(duration=0.056)
    assert run.session.throws == 1
    run.go_on(900)
    assert not run.results('final')  # nothing is concluded from messages that are late
    run.go_on(150)
    (final,) = run.results('final')
    assert not final.is_valid
    assert all(math.isfinite(value) for outputs in run.outputs for value in outputs.state)


@pytest.mark.parametrize(
    ('rate', 'request_', 'reason'),
    [
        (1200.0, {'measured__window': 4e-3 * 0.75}, '3 in a crossing of the wave'),
        (1200.0, {'layer__thickness': 0.05, 'layer__wave_speed': 7.8, 'measured__window': 3.1e-3,
                  'measured__start': 0.2}, '4 in measured.window'),
        (1700.0, {'layer__thickness': 0.05, 'measured__window': 2e-3}, '4 in measured.window'),
    ],
)  # fmt: skip
def test_rate_that_is_too_low_is_refused_with_the_number(rate, request_, reason) -> None:
    run = Run(**request_)
    run.throw(rate=rate, duration=0.3, onset=0.2)
    assert run.session.throws == 0
    notices = run.notices()
    assert notices
    assert all(f'measured at {rate:.0f} Hz, which must be at least' in text for text in notices)
    assert all(reason in text for text in notices)


def test_window_that_is_too_long_for_the_plate_is_refused() -> None:
    settings = {**TWIN.defaults(), 'engine.motion': 'measured', 'measured.window': 4e-3}
    with pytest.raises(ValueError, match=r'at most 0\.2 of .* 0\.003165 s .* got 0\.004'):
        check(settings)
    check({**settings, 'engine.motion': 'underdamped'})


def test_disturbed_samples_are_counted_and_do_little() -> None:
    run = Run()
    samples = measured_throw(run.rig, begin_ns=BEGIN, noise=2e-6)
    random = np.random.default_rng(6)
    for index, sample in enumerate(samples):
        arriving = [sample]
        if index % 10 == 3:
            arriving.append(sample)
        elif index % 10 == 7:
            arriving = [sample._replace(plate=math.nan)]
        elif index % 50 == 5:
            arriving.append(sample._replace(stamp_ns=sample.stamp_ns + SECOND))
            arriving.append(sample._replace(stamp_ns=sample.stamp_ns - 2 * SECOND))
        for item in arriving:
            run.send([item], [sample.stamp_ns - item.stamp_ns + random.integers(1e5, 1.5e5)])
    run.go_on()
    assert run.session.refused == {'doubled': 60, 'not finite': 60, 'future': 12, 'past': 12}
    (release,) = run.results('release')
    assert release.first is not None
    assert release.first.speed == pytest.approx(simulate(run.rig).ejection_speed, rel=0.01)


def test_throw_cannot_be_asked_for() -> None:
    run = Run()
    with pytest.raises(RequestRejected, match='a throw starts when it jumps up'):
        run.session.request_throw()


# schedule


def test_next_jump_after_a_rest_starts_the_next_throw() -> None:
    run = Run(layer__thickness=0.0095)
    run.throw(duration=0.15)
    run.session.change({'layer.thickness': 0.0168})
    assert run.session.pending == {'layer.thickness': 0.0168}
    flat = measured_throw(run.rig, begin_ns=BEGIN + 150_000_000, onset=1.0, duration=0.05)
    run.send(flat)
    run.throw(begin_ns=BEGIN + 200_000_000)
    assert run.session.throws == 2
    first, second = run.results('release')
    assert first.rig.layer.thickness == 0.0095
    assert second.rig.layer.thickness == 0.0168  # it takes effect with the throw
    assert run.session.pending == {}
    (final,) = run.results('final')
    assert final.ended_by in ('next', 'rest', 'max_events')


@pytest.mark.parametrize('is_flying', [False, True])
def test_jump_takes_over_another_motion_that_waits(is_flying) -> None:
    run = Run(throw__period=0.0)
    if is_flying:
        run.throw()
        run.send(measured_throw(run.rig, begin_ns=BEGIN + 120_000_000, onset=1.0, duration=0.04))
        run.go_on()
    throws = run.session.throws
    run.session.change({'engine.motion': 'underdamped'})
    begin_ns = BEGIN + SECOND // 1000 * run.session.step
    run.throw(begin_ns=begin_ns)
    assert run.session.throws == throws
    assert not run.session.is_measured
    assert run.phases()[-1] is Phase.RETURNING
    run.go_on(200)
    assert run.phases()[-2:] == [Phase.RETURNING, Phase.REST]
    assert list(map(bits, run.repeat())) == list(map(bits, run.outputs))


def test_plate_at_rest_is_shown_where_it_is_measured() -> None:
    run = Run()
    run.throw(duration=0.2)
    run.session.reset()
    run.go_on(2)
    assert run.results('final')[0].ended_by == 'reset'
    state = run.outputs[-1].state
    assert state.plate_position == pytest.approx(float(plate_of(run.rig).position(0.15)), abs=2e-5)
    rest = run.outputs[0].state
    assert state.projectile_position - state.plate_position == pytest.approx(
        rest.projectile_position
    )


def test_measurement_can_be_switched_on_and_off() -> None:
    run = Run(engine__motion='underdamped', throw__period=0.0)
    assert not run.session.is_measured
    run.session.measure([Sample(BEGIN, 0.0)])  # nobody listens
    run.session.change({'engine.motion': 'measured'})
    run.session.request_throw()  # which takes over what was pending first, and then there is none
    run.throw()
    assert run.session.is_measured
    assert run.session.throws == 1
    assert len(run.results('release')) == 1
    run.session.change({'engine.motion': 'underdamped'})
    run.session.reset()
    run.go_on(200)
    assert not run.session.is_measured
    assert run.session.throws == 1
    run.session.request_throw()
    run.go_on(20)
    assert len(run.results('release')) == 2
    again = run.repeat()
    assert list(map(bits, again)) == list(map(bits, run.outputs))


# once more


@settings(max_examples=8, deadline=None)
@given(seed=st.integers(0, 1000), throw=st.integers(0, 2), batch=st.sampled_from([10.0, 1000.0]))
def test_journal_repeats_a_measured_run_to_the_last_bit(seed, throw, batch) -> None:
    run = Run(rate__state=1000.0, rate__field=batch)
    random = np.random.default_rng(seed)
    for number in range(2):
        begin = BEGIN + number * 120_000_000
        samples = measured_throw(
            run.rig, begin_ns=begin, noise=5e-6, jitter=0.4, seed=seed + number, duration=0.12
        )
        run.send(samples, random.integers(0, 2_000_000, len(samples)).tolist())
        run.go_on()
        run.session.reset()
    run.go_on(5)
    again = run.repeat(throw if throw <= run.session.throws else 0)
    assert again
    first = again[0].step
    for ours, theirs in zip(run.outputs[first:], again, strict=True):
        assert bits(ours)[1:] == bits(theirs)[1:]
        assert ours.state == theirs.state
        assert first == theirs.step or ours.phases == theirs.phases


SPOILT = {
    'plate': st.sampled_from([0.0, 0.3004, -50.0, 99.0, 1e300, math.nan, -math.inf]),
    'plate_velocity': st.sampled_from([0.0, 10.0, -999.0, math.inf]),
    'projectile': st.sampled_from([math.nan, 5.0, -99.0, math.inf]),
}


@settings(max_examples=15, deadline=None)
@given(
    model=st.sampled_from(['travelling_wave', 'finite_difference_glued', 'spring_mass']),
    rate=st.sampled_from([2000.0, 5000.0, 20_000.0]),
    wait=st.sampled_from([0.0, 1e-3]),
    spoilt=st.lists(
        st.tuples(st.floats(0.0, 1.0), st.fixed_dictionaries({}, optional=SPOILT)),
        max_size=20,
    ),
    moved=st.lists(st.tuples(st.floats(0.0, 1.0), st.integers(-(10**8), 10**8)), max_size=20),
    gap=st.tuples(st.floats(0.0, 1.0), st.integers(0, 100)),
)
def test_whatever_is_measured_is_followed_or_refused_and_repeated(
    model, rate, wait, spoilt, moved, gap
) -> None:
    run = Run(model=model, measured__wait=wait)
    samples = measured_throw(run.rig, begin_ns=BEGIN, noise=5e-6, jitter=0.4, rate=rate)
    last = len(samples) - 1
    for place, values in spoilt:
        samples[int(place * last)] = samples[int(place * last)]._replace(**values)
    delays = np.random.default_rng(7).integers(0, 2_000_000, len(samples)).tolist()
    for place, shift in moved:
        index = int(place * last)
        samples[index] = samples[index]._replace(stamp_ns=samples[index].stamp_ns + shift)
        delays[index] -= shift
    first = int(gap[0] * last)
    del samples[first : first + gap[1]]
    del delays[first : first + gap[1]]
    run.send(samples, delays)
    run.go_on(10)
    assert run.session.taken + sum(run.session.refused.values()) == len(samples)
    assert all(math.isfinite(value) for outputs in run.outputs for value in outputs.state)
    again = run.repeat()
    assert [outputs.state for outputs in again] == [outputs.state for outputs in run.outputs]
    assert [outputs.prediction for outputs in again] == [
        outputs.prediction for outputs in run.outputs
    ]


def test_journal_without_samples_of_an_entry_is_noticed() -> None:
    run = Run()
    run.throw(duration=0.4)
    entries = [journal.decode(line) for line in run.journal]
    told = [entry for entry in entries if entry['kind'] == 'samples']
    assert len(told) > 1
    for earlier, later in itertools.pairwise(told):
        assert later['first'] == earlier['first'] + earlier['count']
    assert sum(len(line) for line in run.journal) < 25 * run.session.taken + 20_000


def test_journal_tells_that_nothing_is_measured() -> None:
    run = Run()
    run.go_on(450)
    entries = [journal.decode(line) for line in run.journal]
    told = [entry for entry in entries if entry['kind'] == 'samples']
    assert [entry['step'] for entry in told] == [101, 202, 303, 404]
    assert [journal.entry_samples(entry) for entry in told] == [[]] * 4
    assert len(run.repeat()) == 450


def test_throw_without_its_departure_is_refused() -> None:
    run = Run()
    run.throw()
    entry = next(entry for entry in map(journal.decode, run.journal) if entry['kind'] == 'throw')
    with pytest.raises(journal.JournalError, match='has its departure, got None'):
        Session.from_entry({**entry, 'departure': None})
