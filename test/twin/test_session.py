# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The twin without ROS and without a clock: integer steps."""

from __future__ import annotations

import contextlib
import math
import os
import threading

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from soft_throw_ros.configuration import rig_of
from soft_throw_ros.core.throw import simulate
from soft_throw_ros.storage.message import SECOND
from soft_throw_ros.twin import journal
from soft_throw_ros.twin.prepared_rig import prepare, RETURN_TIME
from soft_throw_ros.twin.results import Phase
from soft_throw_ros.twin.session import RequestRejected, Session, TickSchedule
from twin_runs import complete_settings, Run, stroke

RETURN = round(1000 * RETURN_TIME)


# schedule


@given(rate=st.floats(10.0, 5000.0), start=st.integers(1, 2**61), steps=st.integers(0, 10**10))
def test_deadlines_never_drift(rate, start, steps) -> None:
    schedule = TickSchedule(step=7, time_ns=start, rate=rate)
    exact = start + steps * SECOND / rate
    assert abs(schedule.deadline(7 + steps) - exact) <= 1 + 4e-16 * exact


@given(rate=st.floats(10.0, 5000.0), stall=st.integers(0, 10**13))
def test_skipping_leaves_the_allowed_catch_up(rate, stall) -> None:
    schedule = TickSchedule(step=0, time_ns=SECOND, rate=rate)
    now, allowed, period = SECOND + stall, SECOND // 10, SECOND / rate
    ticks = schedule.skip(step=0, now=now, max_catch_up=allowed)
    late = now - schedule.deadline(0)
    assert (ticks == 0) == (stall < allowed + period)
    assert late == stall if not ticks else allowed - 2 <= late <= allowed + period + 2


@pytest.mark.parametrize(
    ('rate', 'time_scale', 'period', 'ticks'),
    [
        (1000.0, 1.0, 1.0, 1000),
        (500.0, 1.0, 1.0, 500),
        (1000.0, 0.5, 1.0, 2000),
        (1000.0, 1.0, 0.05, 50),
        (10.0, 10.0, 1, 2),
    ],
)
def test_period_is_time_of_the_rig(rate, time_scale, period, ticks) -> None:
    run = Run(rate__state=rate, time_scale=time_scale, throw__period=period, rate__field=10.0)
    run.go(5 * ticks + 1)
    assert run.starts() == [ticks * k for k in range(1, 6)]
    finals = [(result.throw, result.ended_by) for result in run.results('final')]
    assert finals == [(throw, 'period') for throw in range(1, 5)]


def test_period_zero_throws_only_on_request() -> None:
    run = Run(throw__period=0)
    assert not any(outputs.phases for outputs in run.go(5000)[1:])
    run.session.request_throw()
    with pytest.raises(RequestRejected, match='throw 1'):
        run.session.request_throw()
    (outputs,) = run.go(1)
    assert (run.phases()[-1], outputs.throw) == (Phase.CONTACT, 1)
    run.go(1500)
    run.session.change({'throw.period': 2.0})
    run.go(600)
    assert run.starts() == [5000, 7000]  # counted from the one that was requested
    run.go_until(Phase.REST)
    for period, throws in ((0.0, 2), (0.5, 3)):
        run.session.change({'throw.period': period})
        run.go(400)
        assert len(run.starts()) == throws


@pytest.mark.parametrize(
    ('request_', 'steps', 'reason'),
    [
        ({}, 1100, r'throw 1 .* 0\.90 s'),
        ({}, 1950, r'resetting.* 0\.05 s'),
        ({'throw__period': 0}, 100, r'throw 1 is under way$'),
    ],
)
def test_request_under_way_is_rejected(request_, steps, reason) -> None:
    run = Run(**request_)
    if request_:
        run.session.request_throw()
    run.go(steps)
    entries = run.entries('input')
    with pytest.raises(RequestRejected, match=reason):
        run.session.request_throw()
    assert run.entries('input') == entries  # the journal has no rejected request


# phases and the way back


@pytest.mark.parametrize(
    ('request_', 'reasons'),
    [
        ({'throw__max_events': 3}, {'max_events'}),
        ({'gravity': 0, 'rate__state': 100.0}, {'duration'}),  # it never lands
        ({'engine__frequency': 5, 'engine__amplitude': 1e-3}, {'rest', 'duration'}),  # nor leaves
    ],
)
def test_every_throw_ends(request_, reasons) -> None:
    run = Run(throw__period=0, **request_)
    run.session.request_throw()
    run.go_until(Phase.RETURNING)
    run.go_until(Phase.REST)
    (result,) = run.results('final')
    between = {'contact', 'flight', 'landed'} if 'throw__max_events' in request_ else set()
    first, second, *others, returning, last = [phase.value for phase in run.phases()]
    assert (first, second, returning, last) == ('rest', 'contact', 'returning', 'rest')
    assert between <= {second, *others} <= {'contact', 'flight', 'landed'}
    assert result.ended_by in reasons
    assert result.recontacts + result.landings == request_.get('throw__max_events', 0)
    assert (result.apex_height == math.inf) == ('gravity' in request_)
    assert (result.first is None) == ('engine__frequency' in request_)


@pytest.mark.parametrize('request_', [{}, {'time_scale': 0.5, 'rate__state': 333.0}])
def test_phases_have_the_times_of_their_events_between_steps(request_) -> None:
    run = Run(throw__max_events=3, **request_)
    run.go_until(Phase.RETURNING)
    _, contact, *others, returning = run.phase_changes()
    start_step = run.entries('throw')[0]['step']
    scale = request_.get('time_scale', 1.0)
    assert contact.stamp_ns == run.schedule.deadline(start_step)
    since = [(change.stamp_ns - contact.stamp_ns) * 1e-9 for change in others]
    expected = [event.time / scale for event in run.events()]
    assert since == pytest.approx(expected, rel=0.0, abs=1.5e-9)
    assert returning.stamp_ns == run.schedule.deadline(run.session.step - 1)


def test_phases_after_skipped_ticks_stay_between_the_stamps_of_their_steps() -> None:
    run = Run()
    run.go_until(Phase.CONTACT)
    run.schedule.skip(
        step=run.session.step, now=run.schedule.deadline(run.session.step) + 10**9,
        max_catch_up=10**8,
    )
    run.session.set_tick_schedule(run.schedule)
    outputs = run.go_until(Phase.FLIGHT)
    (change,) = outputs.phases
    last, step = (run.schedule.deadline(outputs.step - late) for late in (1, 0))
    assert last < change.stamp_ns <= step


def test_projectile_that_chatters_on_a_stiff_layer_is_thrown() -> None:
    run = Run(throw__period=0, gravity=0, engine__frequency=1.0, layer__wave_speed=73.0)
    run.session.request_throw()
    run.go_until(Phase.RETURNING)
    (result,) = run.results('final')
    assert result.ended_by == 'max_events'
    assert result.first.ejection_time == pytest.approx(1.31e-3, abs=1e-5)


def test_recontact_is_contact_and_no_landing() -> None:
    # a thin stiff layer catches up with the projectile
    run = Run(engine__frequency=31.1, layer__thickness=2e-3, throw__period=0)
    run.session.request_throw()
    run.go_until(Phase.LANDED)
    kinds = [event.kind for event in run.events()]
    names = {'release': 'flight', 'recontact': 'contact', 'landing': 'landed'}
    assert [phase.value for phase in run.phases()[2:]] == [names[kind] for kind in kinds]
    run.session.reset()
    run.go(1)
    (result,) = run.results('final')
    assert (result.recontacts, result.landings) == (kinds.count('recontact'), 1)
    assert result.recontacts >= 1
    assert result.first != result.last


@pytest.mark.parametrize('request_', [{}, {'throw__max_events': 1}, {'throw__period': 0.07}])
def test_positions_are_continuous_through_changes(request_) -> None:
    run = Run(**request_)
    run.go(1500)
    run.session.change({'layer.thickness': 0.03, 'projectile.mass': 0.02})
    run.go(1700)
    run.session.reset()
    run.go(1700)
    run.session.change({'layer.thickness': 5e-3})
    run.go(1500)
    plate, projectile = np.array([outputs.state[:2] for outputs in run.outputs]).T
    speeds = np.array([outputs.state[2:4] for outputs in run.outputs])
    # The return to rest adds little to the largest speed of the bodies
    fastest = np.abs(speeds).max()
    assert np.abs(np.diff(plate)).max() < 1.05e-3 * fastest
    assert np.abs(np.diff(projectile)).max() < 1.05e-3 * fastest
    assert (projectile > plate).all()
    layers = [outputs.layer.height for outputs in run.outputs if outputs.layer]
    assert all((np.diff(height) > 0.0).all() for height in layers)


def test_returning_ends_at_rest_without_a_jump() -> None:
    run = Run()
    run.go_until(Phase.RETURNING)
    origin = run.outputs[-1].state
    path = np.array([outputs.state for outputs in run.go(RETURN)])
    np.testing.assert_allclose(path[-1], run.outputs[0].state, atol=2e-5)
    assert abs(path[0, 1] - origin.projectile_position) < 1e-6
    # velocity is that of the path
    np.testing.assert_allclose(
        np.gradient(path[:, 1], 1e-3)[1:-2], path[1:-2, 3], rtol=0.01, atol=2e-3
    )


# outputs


@pytest.mark.parametrize(
    ('request_', 'tolerance'),
    [({}, 1e-6), ({'layer__loss_tangent': 0.05}, 1e-3),
     ({'layer__stress_strain_law': 'neo_hookean'}, 1e-3)],
)
def test_results_agree_with_the_exact_throw_and_loads_end_with_the_release(
    request_, tolerance
) -> None:
    run = Run(**request_)
    run.go(2000)
    exact = simulate(run.rig, until=0.291)
    (release,), (final,) = run.results('release'), run.results('final')
    assert release.first == final.first
    for name in ('ejection_time', 'ejection_speed', 'energy_transfer'):
        value = getattr(release.first, name)
        assert value == pytest.approx(getattr(exact, name), rel=2.0 * tolerance)
    assert release.peak_plate_speed == pytest.approx(exact.peak_plate_speed, rel=1e-12)
    loose = 1e-3 + 20.0 * tolerance
    assert release.apex_height == pytest.approx(exact.apex_height, rel=loose)
    assert release.peak_strain == pytest.approx(float(np.max(exact.loads.strain)), rel=loose)
    assert release.peak_plate_force == pytest.approx(exact.loads.plate_force, rel=loose)
    assert release.peak_acceleration == pytest.approx(exact.loads.acceleration, rel=loose)
    assert release.plate_work > 0.5 * exact.rig.projectile.mass * exact.ejection_speed**2
    loads = ('peak_strain', 'peak_plate_force', 'peak_acceleration', 'plate_work')
    assert all(getattr(final, name) == getattr(release, name) for name in loads)
    assert run.events()[0].time == pytest.approx(exact.events[0].time, rel=2.0 * tolerance)


@pytest.mark.parametrize(('state', 'field'), [(1000.0, 50.0), (1000.0, 300.0), (100.0, 1000.0)])
def test_layer_is_published_at_its_rate(state, field) -> None:
    run = Run(throw__period=0)
    run.session.change({'rate.state': state, 'rate.field': field})
    run.session.reset()
    run.go_until(Phase.REST)
    rows = sum(outputs.layer is not None for outputs in run.go(round(10 * state)))
    assert rows == pytest.approx(10 * min(state, field), abs=1)


def test_throw_field_is_published_once_per_throw_with_its_start() -> None:
    run = Run()
    run.go(3100)
    shown = [(outputs.throw, outputs.throw_field) for outputs in run.outputs]
    fields = [(throw, field()) for throw, field in shown if field is not None]
    assert [throw for throw, _ in fields] == [1, 2, 3]
    assert [field.start_ns for _, field in fields] == [
        run.schedule.deadline(step) for step in run.starts()
    ]


# changes


@pytest.mark.parametrize(
    'changes',
    [{'layer.thickness': 0.01, 'projectile.mass': 2e-3, 'engine.amplitude': 1e-3},
     {'layer.loss_tangent': 0.1}, {'gravity': 5.0}, {'measured.latency': 1e-3},
     {'rate.field': 20.0}, {'time_scale': 0.5}],
)
@pytest.mark.parametrize('ends', ['reset', 'period'])
def test_changes_of_rig_measurement_or_rate_wait_beside_one_that_is_effective(
    changes, ends
) -> None:
    run = Run()
    run.go(1200)
    for name, value in changes.items():
        run.session.change({name: value, 'throw.max_events': 3})
    assert run.session.pending == changes
    if ends == 'reset':
        run.session.reset()
        assert run.session.pending == {}
    run.go(2200)
    before, after, *_ = run.entries('throw')
    assert run.session.pending == {}
    assert not changes.items() & before['settings'].items()
    assert {**changes, 'throw.max_events': 3}.items() <= after['settings'].items()
    first, second = (result.rig for result in run.results('release')[:2])
    assert (first == second) == (rig_of(before['settings']) == rig_of(after['settings']))


def test_period_goes_on_when_the_rate_changes() -> None:
    run = Run(throw__max_events=1)
    run.go(1001)
    run.session.change({'rate.state': 500.0})
    end = run.go_until(Phase.RETURNING).step
    run.go(1000)
    first, second, *_ = run.starts()
    assert 1e-3 * (end - first) + 2e-3 * (second - end) == pytest.approx(1.0, abs=4e-3)


@pytest.mark.parametrize('give', [Session.reset, lambda session: session.change({'gravity': 5.0})])
def test_input_of_another_thread_waits_for_the_end_of_a_step(give) -> None:
    def on_entry(line: str) -> None:
        if journal.decode(line)['kind'] == 'throw':  # in the middle of a step
            thread.start()
            thread.join(0.1)
            is_waiting.append(thread.is_alive())

    is_waiting, session = [], Session(prepare(complete_settings()), on_entry=on_entry)
    thread = threading.Thread(target=give, args=(session,))
    list(session.advance_to(1100))
    assert is_waiting == [True]
    thread.join()


def test_change_at_rest_waits_for_the_throw_and_replaces_the_layer_first() -> None:
    run = Run(throw__period=0)
    run.go(10)
    rest = run.outputs[-1].state
    run.session.change({'layer.thickness': 0.01})
    assert all(outputs.state == rest for outputs in run.go(500))
    run.session.request_throw()
    (outputs,) = run.go(1)
    assert [change.phase for change in outputs.phases] == [Phase.RETURNING]
    run.go_until(Phase.CONTACT)
    assert run.starts() == [510 + RETURN]
    assert run.outputs[-1].state.projectile_position == pytest.approx(0.01, abs=1e-4)


def test_rig_that_cannot_be_stepped_is_refused_with_the_number() -> None:
    run, stiff = Run(), {'layer.wave_speed': 200.0, 'layer.thickness': 0.5e-3}
    with pytest.raises(ValueError, match='200'):
        run.session.change({**stiff, 'layer.loss_tangent': 0.1})
    assert run.session.pending == {}
    assert run.entries('input') == []


def test_reset_ends_the_throw_and_restarts_the_period() -> None:
    run = Run()
    run.go(1100)
    run.session.reset()
    outputs = run.go(2000)[0]
    assert [change.phase for change in outputs.phases] == [Phase.RETURNING]
    assert run.results('final')[0].ended_by == 'reset'
    assert run.starts() == [1000, 2100]


# once more


CHANGES = {
    'layer.thickness': [5e-3, 0.0168, 0.03],
    'gravity': [0.0, 9.81],
    'layer.loss_tangent': [0.0, 0.05],
    'layer.stress_strain_law': ['linear', 'neo_hookean'],
    'rate.state': [200.0, 1000.0],
    'time_scale': [0.3, 1.0],
    'throw.period': [0.0, 0.05, 0.21],
    'throw.max_events': [1, 5],
}
INPUTS = st.sampled_from(['throw', 'reset']) | st.fixed_dictionaries(
    {}, optional={name: st.sampled_from(values) for name, values in CHANGES.items()}
)


@settings(max_examples=25)
@given(
    inputs=st.lists(st.tuples(st.integers(1, 300), INPUTS), min_size=1, max_size=12),
    data=st.data(),
)
def test_any_run_is_replayed_bit_by_bit_from_any_throw(inputs, data) -> None:
    run = Run(throw__period=0.15)
    for steps, kind in inputs:
        run.go(steps)
        if kind == 'throw':
            with contextlib.suppress(RequestRejected):
                run.session.request_throw()
        elif kind == 'reset':
            run.session.reset()
        else:
            run.session.change(kind)
    run.go(300)
    throw = data.draw(st.integers(0, run.session.throws))
    run.assert_repeated(throw)


# motions from files


def test_motions_are_read_when_their_files_are_set_and_replayed_without_them(write) -> None:
    path, other = (write(stroke(), name) for name in ('plate.csv', 'other.csv'))
    run = Run(engine__motion_file=str(path))
    first = simulate(run.rig).ejection_time
    run.go(1200)
    write(stroke(1, z=2.5e-3), 'plate.csv')
    os.utime(path, ns=(0, 0))  # at another time
    for values in (
        {'layer.thickness': 0.02},
        {'engine.motion': 'underdamped'},
        {'engine.motion': 'file', 'engine.motion_file': str(other)},
        {'engine.motion_file': str(path)},
    ):
        run.session.change(values)
        run.go(1000)
    releases = [result.first for result in run.results('release')]
    assert releases[0].ejection_time == pytest.approx(first, rel=1e-9)
    thicker, default, same, edited = (release.ejection_speed for release in releases[1:])
    assert default != thicker == same
    assert edited > 1.2 * same
    path.unlink()
    other.unlink()
    run.assert_repeated()


@pytest.mark.parametrize(('period', 'lead'), [(0.0, 200), (1.0, 200), (0.4, 100), (0.06, 15)])
def test_motion_is_commanded_before_its_throw(write, period, lead) -> None:
    playable = str(write(stroke(3, velocity=-1e-8), 'playable.csv'))
    run = Run(engine__motion_file=playable, engine__command=True, throw__period=period)
    run.go(50)
    if not period:
        run.session.request_throw()
        run.go(10)
        with pytest.raises(RequestRejected, match='throw 1'):
            run.session.request_throw()
    run.session.change({'layer.thickness': 0.02})  # waits until the commanded throw is over
    run.go(2500)
    commands = [output for output in run.outputs if output.command is not None]
    starts = run.starts()
    assert len(commands) == len(starts) or len(commands) == len(starts) + 1
    for outputs, start in zip(commands, starts, strict=False):
        assert start - outputs.step == lead
        assert outputs.command.start_ns == run.schedule.deadline(start)
        assert outputs.command.motion == run.rig.engine.motion
    run.assert_repeated()


@pytest.mark.parametrize('steps', [100, 220, 240])  # before the start, in the motion, near its end
def test_next_command_waits_for_the_end_of_the_motion(write, steps) -> None:
    playable = str(write(stroke(), 'playable.csv'))
    run = Run(engine__motion_file=playable, engine__command=True, throw__period=0.0)
    run.session.request_throw()
    run.go(steps)
    run.session.change({'rate.state': 2000.0})
    run.session.reset()
    run.session.reset()
    for _ in range(1500):
        run.go(1)
        with contextlib.suppress(RequestRejected):
            run.session.request_throw()
    first, second, *_ = (outputs for outputs in run.outputs if outputs.command is not None)
    start = first.step + 200
    assert first.command.start_ns == run.schedule.deadline(start)
    remaining = run.rig.engine.motion.end_time + 1e-3 * (start - steps)  # since the reset [s]
    assert second.step - steps >= 2000.0 * remaining
    run.assert_repeated()
