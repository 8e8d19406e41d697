# SPDX-License-Identifier: Apache-2.0
"""The twin without ROS and without a clock: integer steps."""

from __future__ import annotations

import contextlib
from itertools import pairwise
import math
from typing import Any

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest
from soft_throw_ros.configuration import rig_of, TWIN
from soft_throw_ros.core.throw import simulate
from soft_throw_ros.twin import journal
from soft_throw_ros.twin.pace import Pace
from soft_throw_ros.twin.plan import RETURN_TIME
from soft_throw_ros.twin.results import Outputs, Phase, ThrowResult
from soft_throw_ros.twin.session import Refused, replay, Session

RETURN = round(1000 * RETURN_TIME)


class Run:
    """A session, its journal, and all that came out."""

    def __init__(self, **request: Any) -> None:
        self.journal: list[str] = []
        self.outputs: list[Outputs] = []
        named = {name.replace('__', '.'): value for name, value in request.items()}
        settings = {**TWIN.defaults(), **TWIN.change(TWIN.defaults(), named)}
        self.session = Session(settings, on_entry=self.journal.append)

    def go(self, steps: int) -> list[Outputs]:
        """Go so many steps on, and return what they give."""
        outputs = [self.session.advance() for _ in range(steps)]
        self.outputs += outputs
        return outputs

    def go_until(self, phase: Phase, limit: int = 20_000) -> Outputs:
        """Go on to the step that enters a phase."""
        for _ in range(limit):
            (outputs,) = self.go(1)
            if phase in outputs.phases:
                return outputs
        raise AssertionError(f'{phase} has not come in {limit} steps')

    def results(self, stage: str) -> list[ThrowResult]:
        return [
            result
            for outputs in self.outputs
            for result in outputs.results
            if result.stage == stage
        ]

    def starts(self) -> list[int]:
        """Return the steps at which throws started."""
        return [entry['step'] for entry in self.entries('throw')]

    def entries(self, kind: str) -> list[dict[str, Any]]:
        entries = map(journal.decode, self.journal)
        return [entry for entry in entries if entry['kind'] == kind]


def same_bits(ours: Outputs, theirs: Outputs) -> bool:
    """Compare everything, arrays by their bytes."""
    return ours[:6] == theirs[:6] and all(map(same_arrays, ours[6:], theirs[6:]))


def same_arrays(ours: tuple[Any, ...] | None, theirs: tuple[Any, ...] | None) -> bool:
    if ours is None or theirs is None:
        return ours is theirs
    return [array.tobytes() for array in ours] == [array.tobytes() for array in theirs]


# schedule


def test_throws_come_every_period() -> None:
    run = Run()
    run.go(4500)
    assert run.starts() == [1000, 2000, 3000, 4000]
    assert [result.ended_by for result in run.results('final')] == ['period'] * 3
    assert [result.throw for result in run.results('final')] == [1, 2, 3]


@pytest.mark.parametrize(
    ('rate', 'time_scale', 'period', 'ticks'),
    [
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


def test_period_zero_throws_only_when_asked() -> None:
    run = Run(throw__period=0)
    assert not any(outputs.phases for outputs in run.go(5000)[1:])
    run.session.ask_throw()
    (outputs,) = run.go(1)
    assert outputs.phases == (Phase.CONTACT,)
    assert outputs.throw == 1
    assert run.starts() == [5000]


def test_throw_asked_for_starts_the_period_anew() -> None:
    run = Run()
    run.go(300)
    run.session.ask_throw()
    run.go(2000)
    assert run.starts() == [300, 1300]  # and the third is due at 2300


def test_throw_is_refused_in_flight_saying_how_long() -> None:
    run = Run()
    run.go(1100)
    with pytest.raises(Refused, match=r'throw 1 is under way: ready in 0\.90 s'):
        run.session.ask_throw()
    run.go(850)
    with pytest.raises(Refused, match=r'being put back: ready in 0\.05 s'):
        run.session.ask_throw()
    assert run.entries('input') == []  # what is refused is no input


def test_throw_is_refused_twice_before_the_next_step() -> None:
    run = Run(throw__period=0)
    run.go(10)
    run.session.ask_throw()
    with pytest.raises(Refused, match='throw 1 is about to start'):
        run.session.ask_throw()


def test_refusal_without_a_period_foretells_the_end() -> None:
    run = Run(throw__period=0, throw__max_events=1)
    run.session.ask_throw()
    run.go(100)
    with pytest.raises(Refused) as refusal:
        run.session.ask_throw()
    foretold = float(str(refusal.value).split()[-2])
    run.go_until(Phase.REST)
    assert 1e-3 * (run.session.step - 100) == pytest.approx(foretold, abs=6e-3)


def test_period_can_be_switched_off_and_on_at_rest() -> None:
    run = Run()
    run.go(10)
    run.session.change({'throw.period': 0.0})
    run.go(3000)
    assert run.starts() == []
    run.session.change({'throw.period': 0.5})
    run.go(10)
    assert run.starts() == [3010]


# phases and path


def test_phases_follow_each_other() -> None:
    run = Run(throw__period=0, throw__max_events=1)
    run.session.ask_throw()
    run.go(600)
    phases = [phase.value for outputs in run.outputs for phase in outputs.phases]
    assert phases == ['rest', 'contact', 'flight', 'landed', 'returning', 'rest']


def test_throw_is_over_after_max_events() -> None:
    run = Run(throw__period=0, throw__max_events=3)
    run.session.ask_throw()
    run.go_until(Phase.RETURNING)
    (result,) = run.results('final')
    assert result.ended_by == 'max_events'
    assert result.landings == 3


def test_throw_that_never_lands_ends() -> None:
    run = Run(throw__period=0, gravity=0, rate__state=100.0)
    run.session.ask_throw()
    run.go_until(Phase.RETURNING)
    (result,) = run.results('final')
    assert result.ended_by == 'duration'
    assert result.apex_height == math.inf


def test_rig_too_weak_to_throw_comes_to_rest() -> None:
    run = Run(throw__period=0, engine__frequency=5.0, engine__amplitude=1e-3, max_strain=0.5)
    run.session.ask_throw()
    run.go_until(Phase.RETURNING)
    (result,) = run.results('final')
    assert result.first is None
    assert result.ended_by in ('rest', 'duration')
    assert run.results('release') == []
    assert 'has not left' in result.sentence()


@pytest.mark.parametrize('request_', [{}, {'throw__max_events': 1}, {'throw__period': 0.07}])
def test_positions_are_continuous_also_through_changes(request_) -> None:
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
    # no faster than what moves fastest by itself, plus the return from there to rest
    fastest = np.abs(speeds).max()
    assert np.abs(np.diff(plate)).max() < 1.05e-3 * fastest
    assert np.abs(np.diff(projectile)).max() < 1.05e-3 * fastest
    assert (projectile > plate).all()


def test_returning_ends_at_rest_without_a_jump() -> None:
    run = Run()
    run.go_until(Phase.RETURNING)
    origin = run.outputs[-1].state
    path = np.array([outputs.state for outputs in run.go(RETURN)])
    rest = run.outputs[0].state
    np.testing.assert_allclose(path[-1], rest, atol=2e-5)
    assert abs(path[0, 1] - origin.projectile_position) < 1e-6
    # velocity is that of the path
    np.testing.assert_allclose(
        np.gradient(path[:, 1], 1e-3)[1:-2], path[1:-2, 3], rtol=0.01, atol=2e-3
    )


# outputs


def test_rest_is_where_the_layer_sags_to() -> None:
    run = Run()
    (outputs,) = run.go(1)
    rig = rig_of(TWIN.defaults())
    weight = rig.projectile.mass * rig.gravity
    assert outputs.state.plate_position == 0.0
    assert outputs.state.projectile_position == rig.layer.thickness - rig.static_sag
    assert outputs.state.projectile_force == pytest.approx(weight)
    assert outputs.state.plate_force == pytest.approx(-weight)
    assert outputs.field is not None
    sag = -rig.static_sag / rig.layer.thickness
    np.testing.assert_allclose(outputs.field.strain, sag, rtol=1e-9)
    np.testing.assert_allclose(outputs.field.velocity, 0.0)


def test_result_agrees_with_the_exact_throw() -> None:
    run = Run()
    run.go(2000)
    exact = simulate(rig_of(TWIN.defaults()), until=0.291)
    (release,), (final,) = run.results('release'), run.results('final')
    assert release.first == final.first
    assert release.first is not None
    assert release.first.time == pytest.approx(exact.ejection_time, rel=1e-6)
    assert release.first.speed == pytest.approx(exact.ejection_speed, rel=1e-6)
    assert release.first.energy_transfer == pytest.approx(exact.energy_transfer, rel=1e-6)
    assert release.peak_plate_speed == pytest.approx(exact.peak_plate_speed, rel=1e-12)
    assert release.peak_strain == pytest.approx(exact.peak_strain.value, rel=1e-3)
    assert release.peak_force == pytest.approx(exact.peak_plate_force, rel=1e-3)
    assert release.peak_acceleration == pytest.approx(exact.peak_acceleration, rel=1e-3)
    assert release.apex_height == pytest.approx(exact.apex_height, rel=1e-6)
    assert final.plate_work >= release.plate_work > exact.energies.projectile


def test_result_tells_first_and_last_release_apart() -> None:
    # a thin stiff layer lets the plate catch up: 0.499 and 1.241 without gravity
    run = Run(
        engine__frequency=31.1,
        engine__damping_ratio=0.0,
        layer__thickness=2e-3,
        gravity=0,
        throw__period=0.3,
    )
    run.go(700)
    result = run.results('final')[0]
    assert result.first is not None
    assert result.last is not None
    assert result.first.energy_transfer == pytest.approx(0.499, abs=2e-3)
    assert result.last.energy_transfer == pytest.approx(1.241, abs=2e-3)
    assert result.recontacts >= 1


def test_events_are_those_of_the_exact_throw() -> None:
    run = Run()
    run.go(2000)
    events = [event for outputs in run.outputs for event in outputs.events]
    exact = simulate(rig_of(TWIN.defaults()), until=0.291).events
    assert [event.kind for event in events[:2]] == [event.kind for event in exact]
    for ours, theirs in zip(events[:2], exact, strict=True):
        assert ours.time == pytest.approx(theirs.time, rel=1e-6)
        assert ours.velocity == pytest.approx(theirs.velocity, rel=1e-5)


@pytest.mark.parametrize(('state', 'field'), [(1000.0, 50.0), (1000.0, 300.0), (100.0, 1000.0)])
def test_field_comes_at_its_rate(state, field) -> None:
    run = Run(throw__period=0)
    run.session.change({'rate.state': state, 'rate.field': field})
    run.session.reset()
    run.go_until(Phase.REST)
    rows = sum(outputs.field is not None for outputs in run.go(round(10 * state)))
    assert rows == pytest.approx(10 * min(state, field), abs=1)


def test_throw_field_comes_once_per_throw() -> None:
    run = Run()
    run.go(3100)
    shown = [(outputs.throw, outputs.throw_field) for outputs in run.outputs]
    fields = [(throw, field) for throw, field in shown if field is not None]
    assert [throw for throw, _ in fields] == [1, 2, 3]
    times, strain = fields[0][1]
    release = run.results('release')[0].first
    assert release is not None
    assert times[-1] == pytest.approx(1.5 * release.time)
    assert strain.shape == (times.size, 64)
    assert strain.min() < -0.1  # the squeeze
    np.testing.assert_allclose(strain[times > release.time + 1e-4, -1], 0.0, atol=1e-4)  # free top


def test_strain_beyond_the_limit_is_told() -> None:
    run = Run(max_strain=0.2)
    run.go(1020)
    assert run.results('release')[0].is_linear
    run.session.change({'max_strain': 0.1})
    run.go(1000)
    result = run.results('release')[1]
    assert not result.is_linear
    assert 'beyond the linear 10 %' in result.sentence()


# changes


def test_changes_of_the_rig_take_effect_together_at_the_next_throw() -> None:
    run = Run()
    run.go(1200)
    run.session.change({'layer.thickness': 0.01})
    run.session.change({'projectile.mass': 2e-3, 'engine.amplitude': 1e-3})
    assert run.session.pending == {
        'layer.thickness': 0.01,
        'projectile.mass': 2e-3,
        'engine.amplitude': 1e-3,
    }
    run.go(1000)
    before, after = run.entries('throw')
    assert run.session.pending == {}
    assert before['rig']['layer']['thickness'] == 0.0168
    assert after['step'] == 2000
    assert after['rig']['layer']['thickness'] == 0.01
    assert after['rig']['projectile']['mass'] == 2e-3
    assert run.results('release')[1].rig.layer.thickness == 0.01


def test_change_at_rest_waits_for_the_throw_and_puts_the_layer_in_first() -> None:
    run = Run(throw__period=0)
    run.go(10)
    rest = run.outputs[-1].state
    run.session.change({'layer.thickness': 0.01})
    assert all(outputs.state == rest for outputs in run.go(500))
    run.session.ask_throw()
    assert run.go(1)[0].phases == (Phase.RETURNING,)
    run.go_until(Phase.CONTACT)
    assert run.starts() == [510 + RETURN]
    assert run.outputs[-1].state.projectile_position == pytest.approx(0.01, abs=1e-4)


def test_change_at_rest_takes_effect_at_a_reset() -> None:
    run = Run(throw__period=0)
    run.session.change({'layer.thickness': 0.01})
    run.session.reset()
    run.go_until(Phase.RETURNING)
    assert run.session.pending == {}
    run.go_until(Phase.REST)
    assert run.go(1)[0].state.projectile_position == pytest.approx(0.01, abs=1e-4)


def test_change_while_putting_back_waits_for_the_throw_after() -> None:
    run = Run()
    run.go(1950)
    run.session.change({'layer.thickness': 0.01})
    run.go(2000)
    first, second, third = run.entries('throw')
    assert second['step'] == 2000
    assert second['pending'] == {'layer.thickness': 0.01}
    assert [entry['rig']['layer']['thickness'] for entry in (first, second, third)] == [
        0.0168,
        0.0168,
        0.01,
    ]


def test_change_taken_back_is_no_change() -> None:
    run = Run(throw__period=0)
    run.go(10)
    run.session.change({'layer.thickness': 0.01})
    run.session.change({'layer.thickness': 0.0168})
    assert run.session.pending == {}
    run.session.ask_throw()
    assert run.go(1)[0].phases == (Phase.CONTACT,)


def test_rate_waits_like_the_rig() -> None:
    run = Run()
    run.go(1200)
    run.session.change({'rate.state': 500.0, 'time_scale': 0.5})
    assert (run.session.rate, run.session.time_scale) == (1000.0, 1.0)
    run.go_until(Phase.RETURNING)
    assert (run.session.rate, run.session.time_scale) == (500.0, 0.5)
    start = run.go_until(Phase.CONTACT).step
    assert start == 1900 + RETURN  # as long for the rig, and so many ticks by chance
    assert run.go_until(Phase.CONTACT).step == start + 1000


def test_rig_that_cannot_be_stepped_is_refused_with_the_number() -> None:
    run = Run()
    run.go(10)
    with pytest.raises(ValueError, match='200'):
        run.session.change({'layer.wave_speed': 200.0, 'layer.thickness': 0.5e-3})
    assert run.session.pending == {}
    assert run.entries('input') == []
    run.go(1010)
    assert run.starts() == [1000]


def test_reset_breaks_off_and_counts_the_period_from_there() -> None:
    run = Run()
    run.go(1100)
    run.session.reset()
    outputs = run.go(2000)[0]
    assert outputs.phases == (Phase.RETURNING,)
    assert run.results('final')[0].ended_by == 'reset'
    assert run.starts() == [1000, 2100]


# journal


def test_journal_has_all_inputs_with_their_steps() -> None:
    run = Run()
    run.go(7)
    run.session.ask_throw()
    run.go(5)
    run.session.change({'gravity': 1.62})
    run.session.reset()
    run.go(1)
    assert [(entry['step'], entry['input']) for entry in run.entries('input')] == [
        (7, 'throw'),
        (12, 'parameters'),
        (12, 'reset'),
    ]
    assert run.entries('input')[1]['values'] == {'gravity': 1.62}
    (start,) = run.entries('start')
    assert start['settings'] == TWIN.defaults()
    assert set(start['versions']) >= {'soft_throw_ros', 'numpy', 'numba', 'python'}


@pytest.fixture(scope='module')
def eventful() -> Run:
    """A run with a bit of everything."""
    run = Run(throw__max_events=4)
    run.go(1234)
    run.session.change({'layer.thickness': 0.0123, 'rate.state': 800.0})
    run.session.change({'max_strain': 0.3})
    run.go(1111)
    run.session.reset()
    run.go(77)
    run.session.change({'layer.thickness': 0.0168, 'gravity': 3.7})
    run.session.change({'throw.period': 0.6, 'throw.max_events': 2})
    run.go(2000)
    run.session.change({'throw.period': 0.0, 'time_scale': 0.1, 'rate.field': 333.0})
    run.go(3000)
    run.session.ask_throw()
    run.go(400)
    run.session.change({'projectile.mass': 4e-3})
    run.go(700)
    run.session.change({'throw.period': 0.05, 'engine.frequency': 50.0})
    run.go(3000)
    return run


def test_replay_gives_every_bit_from_any_throw_on(eventful) -> None:
    throws = len(eventful.starts())
    assert throws >= 6
    for throw in range(throws + 1):
        begin = eventful.starts()[throw - 1] if throw else 0
        again = list(replay(eventful.journal, until=eventful.session.step, throw=throw))
        assert len(again) == len(eventful.outputs) - begin
        for ours, theirs in zip(again, eventful.outputs[begin:], strict=True):
            assert same_bits(ours, theirs), f'throw {throw}, step {theirs.step}'


def test_replay_begins_with_the_first_throw_of_a_journal_without_its_start(eventful) -> None:
    lines = eventful.journal[4:]
    again = list(replay(lines, until=eventful.session.step))
    first = next(entry['step'] for entry in map(journal.decode, lines) if entry['kind'] == 'throw')
    assert again[0].step == first
    assert all(map(same_bits, again, eventful.outputs[first:]))


def test_replay_writes_the_same_journal(eventful) -> None:
    written: list[str] = []
    entries = list(map(journal.decode, eventful.journal))
    session = Session.from_entry(entries[0], on_entry=written.append)
    for entry in entries:
        if entry['kind'] == 'input':
            while session.step < entry['step']:
                session.advance()
            session.take(entry)
    while session.step < eventful.session.step:
        session.advance()
    assert written == eventful.journal


def test_replay_refuses_what_does_not_fit(eventful) -> None:
    with pytest.raises(journal.JournalError, match='throw 99'):
        next(replay(eventful.journal, until=10_000, throw=99))
    with pytest.raises(journal.JournalError, match='nonsense'):
        next(replay(['nonsense'], until=10))
    with pytest.raises(journal.JournalError, match='settings'):
        Session.from_entry({'kind': 'throw', 'step': 3})
    with pytest.raises(journal.JournalError, match="'input'"):
        Session.from_entry({'kind': 'input', 'step': 3, 'input': 'throw'})


def test_throw_that_changes_missed_is_repeated_to_the_bit() -> None:
    run = Run(throw__period=0.15)
    run.go(1)
    run.session.ask_throw()
    run.go(76)
    run.session.change({'layer.thickness': 5e-3})  # while things are being put back
    run.go(300)
    begin = run.starts()[1]
    again = list(replay(run.journal, until=run.session.step, throw=2))
    assert len(again) == len(run.outputs) - begin
    assert all(map(same_bits, again, run.outputs[begin:]))


def test_input_of_another_step_is_refused() -> None:
    session = Run().session
    with pytest.raises(journal.JournalError, match='before step 0'):
        session.take({'kind': 'input', 'step': 5, 'input': 'throw'})
    with pytest.raises(journal.JournalError, match='sing'):
        session.take({'kind': 'input', 'step': 0, 'input': 'sing'})


INPUTS = st.one_of(
    st.just(('throw', None)),
    st.just(('reset', None)),
    st.tuples(
        st.just('parameters'),
        st.fixed_dictionaries(
            {},
            optional={
                'layer.thickness': st.sampled_from([5e-3, 0.0168, 0.03]),
                'gravity': st.sampled_from([0.0, 9.81]),
                'rate.state': st.sampled_from([200.0, 1000.0]),
                'time_scale': st.sampled_from([0.3, 1.0]),
                'throw.period': st.sampled_from([0.0, 0.05, 0.21]),
                'throw.max_events': st.sampled_from([1, 5]),
            },
        ),
    ),
)


@given(
    inputs=st.lists(st.tuples(st.integers(1, 300), INPUTS), min_size=1, max_size=12),
    data=st.data(),
)
def test_any_run_is_repeated_to_the_bit(inputs, data) -> None:
    run = Run(throw__period=0.15)
    for steps, (kind, values) in inputs:
        run.go(steps)
        if kind == 'throw':
            with contextlib.suppress(Refused):
                run.session.ask_throw()
        elif kind == 'reset':
            run.session.reset()
        else:
            run.session.change(values)
    run.go(300)
    throw = data.draw(st.integers(0, run.session.throws))
    begin = run.starts()[throw - 1] if throw else 0
    again = list(replay(run.journal, until=run.session.step, throw=throw))
    assert len(again) == len(run.outputs) - begin
    assert all(map(same_bits, again, run.outputs[begin:]))


def test_journal_tells_the_pace_again_before_every_throw() -> None:
    written: list[str] = []
    session = Session({**TWIN.defaults(), 'throw.period': 0.3}, on_entry=written.append)
    pace = Pace(step=0, time_ns=1_000, rate=session.rate)
    session.keep_pace(pace)
    for _ in range(700):
        session.advance()
    entries = [journal.decode(line) for line in written]
    kinds = [entry['kind'] for entry in entries]
    assert kinds == ['start', 'pace', 'pace', 'throw', 'pace', 'throw']
    for before, entry in pairwise(entries):
        if entry['kind'] == 'throw':
            assert before['step'] == entry['step']
            assert vars(journal.entry_pace(before)) == vars(pace)
    again = list(replay(written, until=700))
    assert len(again) == 700


@pytest.mark.parametrize(
    'entry', [{}, {'anchor_time_ns': 0.5}, {'rate': 0.0}, {'rate': '1'}, {'anchor_step': None}]
)
def test_pace_that_is_none_is_refused(entry) -> None:
    whole = journal.pace_entry(3, Pace(step=0, time_ns=1_000, rate=1000.0))
    assert journal.entry_pace(whole).deadline(1) == 1_001_000
    broken = {**whole, **entry} if entry else {'kind': 'pace', 'step': 3}
    with pytest.raises(journal.JournalError, match='pace'):
        journal.entry_pace(broken)
