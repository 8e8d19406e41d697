# SPDX-License-Identifier: Apache-2.0
"""The scene, read back by Rerun itself from what it has written."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
import io
from pathlib import Path
import runpy
import subprocess
from typing import Any

import numpy as np
import pytest
from soft_throw_ros.commands.inspect_bag import energy_transfer
from soft_throw_ros.configuration import TWIN
from soft_throw_ros.configuration.layers import library
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.core.throw import simulate
from soft_throw_ros.core.travelling_wave import first_release
from soft_throw_ros.design.recommendation import recommend
from soft_throw_ros.recording.digest import RECOMMENDATION, Report
from soft_throw_ros.recording.message import Message
from soft_throw_ros.recording.viewer import find_viewer, ViewerError
from soft_throw_ros.twin import journal

rr = pytest.importorskip('rerun')

from rerun.chunk import RrdReader  # noqa: E402
from soft_throw_ros.recording import rerun_scene  # noqa: E402

TwinMessages: Any = runpy.run_path(str(Path(__file__).with_name('twin_messages.py')))[
    'TwinMessages'
]


@pytest.fixture(autouse=True, scope='module')
def mistakes_raise() -> Iterator[None]:
    """Otherwise Rerun logs them and goes on."""
    rr.set_strict_mode(True)
    yield
    rr.set_strict_mode(False)


class Recording:
    """What Rerun reads from a file: rows by entity and component, times in [ns]."""

    def __init__(self, path: Path) -> None:
        reader = RrdReader(path)
        self.entities: dict[str, list[Any]] = {}
        for chunk in reader.stream():
            batch = chunk.to_record_batch()
            self.entities.setdefault(chunk.entity_path, []).append(batch)
        self.views = [
            view for store in reader.blueprints() for view in _views(reader.stream(store=store))
        ]

    def series(self, entity: str, component: str) -> tuple[Any, list[Any]]:
        """Return times and values of a component, by time."""
        times: list[int] = []
        values: list[Any] = []
        for batch in self.entities[entity]:
            if {'stamp', component} <= set(batch.schema.names):
                times += batch.column('stamp').cast('int64').to_pylist()
                values += batch.column(component).to_pylist()
        order = np.argsort(times, kind='stable')
        return np.array(times)[order], [values[place] for place in order]

    def scalars(self, entity: str) -> tuple[Any, Any]:
        times, values = self.series(entity, 'Scalars:scalars')
        return times, np.array(values)

    def last(self, entity: str, component: str) -> Any:
        return self.series(entity, component)[1][-1]

    def styles(self, entity: str) -> set[str]:
        return {name for batch in self.entities[entity] for name in batch.schema.names}


def _views(stream: Any) -> Iterator[tuple[str, str]]:
    for chunk in stream:
        batch = chunk.to_record_batch().to_pydict()
        if 'ViewBlueprint:display_name' in batch:
            yield (
                batch['ViewBlueprint:class_identifier'][0][0],
                batch['ViewBlueprint:display_name'][0][0],
            )


class Show:
    """A scene that is written to files, one after the other."""

    def __init__(self, folder: Path, use: Any = 'bag') -> None:
        self.folder = folder
        self.scene = rerun_scene.Scene(
            energy_transfer, ThreadPoolExecutor(1), name='test', use=use
        )
        self._stream: Any = None

    def begin(self, name: str) -> Path:
        path = self.folder / name
        self._stream = rerun_scene.new_stream()
        rerun_scene.save_to(self._stream, path, is_live=False)
        self.scene.connect(self._stream)
        return path

    def show(self, messages: Sequence[Any], batch: int = 1000) -> None:
        for begin in range(0, len(messages), batch):
            self.scene.show(messages[begin : begin + batch])

    def end(self) -> None:
        self.scene.finish(is_waiting=True)
        assert rerun_scene.flush(self._stream, 10.0)
        self._stream.disconnect()
        self.scene.connect(None)


def record(folder: Path, messages: Sequence[Any]) -> Path:
    show = Show(folder)
    path = show.begin('scene.rrd')
    show.show(messages)
    show.end()
    return path


@pytest.fixture(scope='module')
def twin() -> Any:
    """Two throws in real time."""
    return TwinMessages(throw__period=0.5).go(1200)


@pytest.fixture(scope='module')
def path(twin, tmp_path_factory) -> Path:
    return record(tmp_path_factory.mktemp('scene'), twin.messages)


@pytest.fixture(scope='module')
def recording(path) -> Recording:
    return Recording(path)


def test_scene_is_verified_by_rerun(path) -> None:
    done = subprocess.run(
        [find_viewer(), 'rrd', 'verify', path], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


def test_scene_has_every_state_in_its_units(twin, recording) -> None:
    states = np.array([outputs.state for outputs in twin.outputs])
    due = [twin.pace.deadline(step) for step in range(1200)]
    for name, expected in (
        ('position', 1e3 * states[:, 0:2]),
        ('velocity', states[:, 2:4]),
        ('force', states[:, 4:6] * [-1.0, 1.0]),
    ):
        times, values = recording.scalars(f'/twin/{name}')
        assert times.tolist() == due
        np.testing.assert_array_equal(values, expected)


def test_scene_has_the_energies_of_the_model_at_the_release(twin, recording) -> None:
    throw = simulate(Rig())
    release = twin.pace.deadline(500) + throw.ejection_time * 1e9
    for name, expected, tolerance in (
        ('work', throw.energies.plate_work, 5e-2),  # by states of a millisecond,
        ('projectile', throw.energies.projectile, 5e-2),
        ('layer', throw.energies.layer, 2e-2),  # and by the field of the throw
        ('total', throw.energies.plate_work, 1e-2),
    ):
        times, values = recording.scalars(f'/twin/energy/{name}')
        here = np.isfinite(values[:, 0])
        shown = np.interp(release, times[here], values[here, 0])
        assert shown == pytest.approx(1e3 * expected, rel=tolerance), name


def test_side_view_is_to_scale(twin, recording) -> None:
    """Downwards in mm: the top of the layer is where the projectile's lower face is."""
    times, places = recording.series('/twin/side/projectile', 'Transform3D:translation')
    z_of_projectile = -np.array(places)[:, 0, 1]
    times_of_layer, tops = recording.series('/twin/side/layer', 'Transform3D:translation')
    _, scales = recording.series('/twin/side/layer', 'Transform3D:scale')
    top = -np.array(tops)[:, 0, 1]
    width, height = np.array(scales)[:, 0, 0], 64 * np.array(scales)[:, 0, 1]
    begin = twin.pace.deadline(500)
    in_contact = (times_of_layer >= begin) & (times_of_layer < begin + 7_600_000)
    at_layer = np.interp(times_of_layer[in_contact], times, z_of_projectile)
    assert in_contact.sum() > 100
    np.testing.assert_allclose(top[in_contact], at_layer, atol=0.01)
    np.testing.assert_allclose(width, 12.0)
    np.testing.assert_allclose(height[0], 16.8 - 1e3 * Rig().static_sag, atol=1e-4)
    body = recording.last('/twin/side/projectile/body', 'Transform3D:scale')
    assert body[0][:2] == pytest.approx([12.0, 8.2])


def test_layer_has_the_colour_of_its_strain(twin, recording) -> None:
    """Orange where it is compressed, purple where it is stretched, white at rest."""
    times, pictures = recording.series('/twin/side/layer', 'Image:buffer')
    strains = [outputs.field for outputs in twin.outputs]
    for step in (0, 520):
        pixels = np.array(pictures[int(np.searchsorted(times, twin.pace.deadline(step)))][0])
        red, _, blue = pixels.reshape(64, 3)[::-1].astype(int).T
        strain = np.interp(np.linspace(0.0, 63.0, 64), np.arange(64), strains[step].strain)
        sure = np.abs(strain) > 0.02
        assert ((blue > red) == (strain > 0.0))[sure].all()
        assert sure.any() == (step > 0)
        assert (np.abs(red - blue)[~sure] < 60).all()


def test_picture_of_the_strain_is_there_for_every_throw(twin, recording) -> None:
    times, pictures = recording.series('/twin/strain/picture', 'Image:buffer')
    assert times.tolist() == [twin.pace.deadline(step) for step in (500, 1000)]
    assert [len(picture[0]) for picture in pictures] == [3 * 64 * 200] * 2
    texts = recording.last('/twin/strain/texts', 'Points2D:labels')
    assert {'t (ms)', 'y (mm)', '0', '10', '15'} <= set(texts)
    (label,) = recording.last('/twin/strain/ejection/text', 'Points2D:labels')
    assert label == f'tₑ {1e3 * simulate(Rig()).ejection_time:.2f} ms'
    _, lines = recording.series('/twin/strain/now', 'LineStrips2D:strips')
    assert [len(line) for line in lines] == 2 * ([1] * 200 + [0])


def test_phases_are_states_on_a_timeline(twin, recording) -> None:
    times, phases = recording.series('/twin/phase', 'StateChange:state')
    entered = [
        (twin.pace.deadline(outputs.step), phase.value)
        for outputs in twin.outputs
        for phase in outputs.phases
    ]
    assert list(zip(times, (phase for (phase,) in phases), strict=True)) == entered
    assert 'StateConfiguration:colors' in recording.styles('/twin/phase')


def test_landscape_marks_what_the_model_says(twin, recording) -> None:
    alpha = '\N{GREEK SMALL LETTER ALPHA}'
    now, best = recording.last('/twin/landscape/mark_texts', 'Points2D:labels')
    rig = Rig()
    release = first_release(
        mass_ratio=rig.mass_ratio,
        speed_ratio=rig.speed_ratio,
        damping_ratio=rig.engine.damping_ratio,
        gravity_ratio=rig.gravity_ratio,
    )
    assert now == f'now: {alpha} {release.energy_transfer:.3f}'
    assert best == f'recommended: {alpha} 4.143'
    x, y = recording.last('/twin/landscape/marks', 'Points2D:positions')[0]
    assert x == pytest.approx(200.0 * np.log(16.8) / np.log(50.0), rel=1e-5)
    assert y == pytest.approx(84.0 * (1.0 - np.log(7.8) / np.log(50.0)), rel=1e-5)


def test_landscape_is_brightest_where_the_best_layer_is(recording) -> None:
    pixels = np.array(recording.last('/twin/landscape/picture', 'Image:buffer')[0])
    pixels = pixels.reshape(100, 160, 3).astype(int)
    row, column = np.unravel_index(pixels[:, :, :2].sum(axis=2).argmax(), (100, 160))
    _, best = recording.last('/twin/landscape/marks', 'Points2D:positions')
    assert column == pytest.approx(160.0 / 200.0 * best[0], abs=6)
    assert row == pytest.approx(100.0 / 84.0 * best[1], abs=6)


def test_landscape_of_what_never_leaves_says_so_and_is_coarse(twin, tmp_path) -> None:
    """To find out takes some milliseconds for every layer."""
    settings = {**TWIN.defaults(), 'projectile.mass': 1.0}
    line = journal.encode({'kind': 'start', 'step': 0, 'settings': settings}).encode() + b'\0'
    data = b'\0\1\0\0' + len(line).to_bytes(4, 'little') + line
    recording = Recording(record(tmp_path, [Message(twin.channels['journal'], data, 5, 5)]))
    (now,) = recording.last('/twin/landscape/mark_texts', 'Points2D:labels')
    assert now == 'now: no release'
    pixels = np.array(recording.last('/twin/landscape/picture', 'Image:buffer')[0])
    assert 3 * 100 < pixels.size < 3 * 160 * 100
    assert (pixels.reshape(-1, 3) == 0xB0).all(axis=1).any()


def test_words_have_the_numbers(recording) -> None:
    text = recording.last('/twin/throw_result', 'TextDocument:text')[0]
    throw = simulate(Rig())
    assert text.startswith('**Throw 2**')
    rows = [
        [cell.strip() for cell in line.split('|')[1:-1]]
        for line in text.splitlines()
        if line.startswith('|')
    ]
    heads, _, times_, _, transfers = rows[:5]
    assert heads == ['', 'twin', 'elastic', 'glued on', 'spring']
    assert times_[1] == f'{1e3 * throw.ejection_time:.4g}'
    assert times_[-1] == '6.412'  # of App. A
    assert transfers[1] == f'{throw.energy_transfer:.4g}'
    assert transfers[-1] == '3.098'
    best = recording.last('/twin/recommendation', 'TextDocument:text')[0]
    assert '| 16.8 | 13.4 | 16.8 | 41.8 |' in best
    times, lines = recording.series('/log', 'TextLog:text')
    assert len(lines) == len(times) == 3
    assert lines[0][0].startswith('twin: throw 1: left after 7.647 ms')


def test_layout_has_a_view_of_everything_with_its_unit(recording) -> None:
    alpha = '\N{GREEK SMALL LETTER ALPHA}'
    assert sorted(recording.views) == sorted(
        [
            ('2D', 'Rig, z (mm)'),
            ('2D', 'Strain ε(y, t) in the throw'),
            ('2D', f'Energy transfer {alpha}(Lₛ, cₛ)'),
            ('StateTimeline', 'Phase'),
            ('TimeSeries', 'Position z (mm)'),
            ('TimeSeries', 'Velocity v (m/s)'),
            ('TimeSeries', 'Compressive force F (N)'),
            ('TimeSeries', 'Energy (mJ)'),
            ('TextDocument', 'Throw'),
            ('TextDocument', 'Recommended layer'),
            ('TextLog', 'Log'),
        ]
    )


def test_moment_is_in_the_last_contact(twin, tmp_path) -> None:
    show = Show(tmp_path)
    show.begin('scene.rrd')
    show.show(twin.messages)
    show.end()
    since = show.scene.moment - twin.pace.deadline(1000)
    assert 0.5 < since / 1e9 / simulate(Rig()).ejection_time < 1.0


def test_twins_have_trees_and_tabs_of_their_own(tmp_path) -> None:
    twins = [TwinMessages(node, throw__period=0.1) for node in ('/rig1/twin', '/rig 2/twin')]
    messages = [message for twin in twins for message in twin.go(150).messages]
    messages.sort(key=lambda message: message.log_time)
    recording = Recording(record(tmp_path, messages))
    for root in ('/rig1/twin', r'/rig\ 2/twin'):
        assert len(recording.scalars(f'{root}/position')[0]) == 150
    assert [name for _, name in recording.views].count('Energy (mJ)') == 2


def test_twin_without_journal_is_shown_as_far_as_it_is_known(twin, tmp_path) -> None:
    messages = [each for each in twin.messages if each.channel.topic == '/twin/joint_states']
    recording = Recording(record(tmp_path, messages))
    assert len(recording.scalars('/twin/velocity')[0]) == 1200
    assert not any(entity.startswith('/twin/landscape') for entity in recording.entities)


def test_late_viewer_gets_what_still_holds(twin, tmp_path) -> None:
    show = Show(tmp_path, use='live')
    first = show.begin('first.rrd')
    show.show(twin.messages, batch=100)
    show.end()
    second = show.begin('second.rrd')
    show.end()
    before, after = Recording(first), Recording(second)
    for entity, component in (
        ('/twin/phase', 'StateChange:state'),
        ('/twin/throw_result', 'TextDocument:text'),
        ('/twin/recommendation', 'TextDocument:text'),
        ('/twin/strain/picture', 'Image:buffer'),
        ('/twin/landscape/picture', 'Image:buffer'),
        ('/twin/side/plate/body', 'Image:buffer'),
    ):
        assert after.series(entity, component)[0].size == 1
        assert after.last(entity, component) == before.last(entity, component)
    assert set(after.views) == set(before.views)
    for entity in ('/twin/position', '/twin/phase', '/twin/side/layer'):
        assert after.styles(entity) - {'stamp'} <= before.styles(entity)
        assert any(name.split(':')[-1] in ('colors', 'format') for name in after.styles(entity))
    assert 'Scalars:scalars' not in after.styles('/twin/position')


def test_what_comes_without_a_viewer_is_not_kept(twin) -> None:
    """Nothing grows with time but what a late viewer needs, which is as much after each throw."""
    scene = rerun_scene.Scene(energy_transfer, ThreadPoolExecutor(1), name='test', use='live')
    sizes = []
    for messages in np.array_split(np.arange(len(twin.messages)), 4):
        scene.show([twin.messages[place] for place in messages])
        scene.finish(is_waiting=True)
        sizes.append(len(scene._canvas._rows))
    assert sizes[-1] == sizes[-2]  # the second throw has replaced the first
    assert sizes[-1] < 50


def picture_of(path: Path, **options: Any) -> Any:
    """Take a picture of a recording, if this machine can."""
    image = pytest.importorskip('PIL.Image')
    try:
        data = rerun_scene.photograph(path, **options)
    except ViewerError as error:
        if 'graphics' not in str(error):
            raise
        pytest.skip(str(error))
    with image.open(io.BytesIO(data)) as picture:
        return np.asarray(picture.convert('RGB')).astype(int)


def test_picture_shows_the_throw(twin, path) -> None:
    moment = twin.pace.deadline(1000) + 5_000_000
    picture = picture_of(path, size=(800, 600), moment=moment)
    assert picture.shape == (600, 800, 3)
    red, green, blue = picture[40:320, 10:185].reshape(-1, 3).T
    is_compressed = (red > green + 40) & (green > blue + 40)
    is_projectile = (blue > red + 80) & (blue > green + 20)
    assert is_compressed.sum() > 1000
    # equal to scale: 16.8 mm of layer, some of it hardly strained, below 8.2 mm of projectile
    assert 0.3 < is_projectile.sum() / is_compressed.sum() < 1.0
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 500


def test_layer_picked_from_a_library_stands_beside_that_of_now() -> None:
    materials = {'sylgard_184': library().materials['sylgard_184']}
    best = recommend(Rig(), vary='library', materials=materials)
    report = Report(kind=RECOMMENDATION, stamp=0, message=best.why, values=best.values())
    heads, _, thickness, *_ = rerun_scene._recommendation_text(report).splitlines()
    assert heads.split('|')[2:-1:4] == [' now ', ' **sylgard_184** ']
    cells = [float(cell) for cell in thickness.split('|')[2:-1:4]]
    assert cells == pytest.approx([16.8, 1e3 * best.thickness], rel=1e-3)


def test_map_is_read_back_with_values_colours_and_marks(tmp_path) -> None:
    x, y = np.linspace(10.0, 30.0, 5), np.geomspace(1.0, 100.0, 3)
    values = np.arange(15.0).reshape(5, 3)
    values[1, 0] = np.nan
    path = tmp_path / 'map.rrd'
    stream = rerun_scene.new_stream()
    rerun_scene.save_to(stream, path, is_live=False)
    rerun_scene.draw_landscape(
        stream,
        name='a map',
        axes=(
            rerun_scene.MapAxis(title='x (mm)', values=x),
            rerun_scene.MapAxis(title='y', values=y),
        ),
        panels=[
            rerun_scene.MapPanel(name='a', title='First', symbol='s', values=values),
            rerun_scene.MapPanel(name='b', title='Second', symbol='t', values=values, highest=7.0),
        ],
        marks=[(10.0, 1.0, 'low'), (30.0, 100.0, 'high')],
    )
    assert rerun_scene.flush(stream, 10.0)
    stream.disconnect()
    recording = Recording(path)
    (batch,) = recording.entities['/values/a']
    (tensor,) = batch.column('Tensor:data').to_pylist()[0]
    assert [tensor['shape'], tensor['names']] == [[5, 3], ['x (mm)', 'y']]
    np.testing.assert_array_equal(np.reshape(tensor['buffer'], (5, 3)), values)
    ramp = rerun_scene._UNSIGNED
    for name, highest in (('a', 14.0), ('b', 7.0)):
        buffer = recording.last(f'/{name}/picture', 'Image:buffer')[0]
        pixels = np.reshape(buffer, (3, 5, 3))  # rows downwards
        assert pixels[0, 4].tolist() == ramp[-1].tolist()
        assert pixels[2, 1].tolist() == [0xB0, 0xB0, 0xB0]
        expected = ramp[round(255.0 * values[2, 1] / highest)]
        assert pixels[1, 2].tolist() == expected.tolist()
        texts = recording.last(f'/{name}/texts', 'Points2D:labels')
        assert {'x (mm)', 'y', '10', '30', '1', '100'} <= set(texts)
        assert recording.last(f'/{name}/mark_texts', 'Points2D:labels') == ['low', 'high']
        # values are in the middle of their pixels
        low, high = recording.last(f'/{name}/marks', 'Points2D:positions')
        width, height = 200.0, 84.0
        assert low == pytest.approx([0.1 * width, height - height / 6.0], rel=1e-5)
        assert high == pytest.approx([0.9 * width, height / 6.0], rel=1e-5)
    assert {title for _, title in recording.views} == {'First', 'Second'}
    subprocess.run([find_viewer(), 'rrd', 'verify', path], check=True, timeout=60)


def test_measured_throw_is_drawn_with_prediction_and_residual(tmp_path) -> None:
    rigs: Any = runpy.run_path(str(Path(__file__).parents[1] / 'twin' / 'rigs.py'))
    twin = TwinMessages(engine__motion='measured')
    twin.measure(rigs['measured_throw'](Rig(), begin_ns=twin.now, duration=0.1, onset=0.05))
    recording = Recording(record(tmp_path, twin.messages))
    predictions = [outputs.prediction for outputs in twin.outputs if outputs.prediction]
    stamps, values = recording.scalars('/twin/position/predicted')
    assert stamps.tolist() == [item.stamp_ns for item in predictions]
    assert values[:, 0] == pytest.approx([1e3 * item.position for item in predictions])
    _, residuals = recording.scalars('/twin/residual')
    expected = [[1e6 * item[1], 1e6 * item[2]] for item in _residuals(twin)]
    np.testing.assert_allclose(residuals, expected)
    _, truth = recording.scalars('/twin/position/measured')
    assert truth[:, 1].max() > 1e3 * Rig().layer.thickness
    assert any('Model less measurement' in title for _, title in recording.views)
    text = recording.last('/twin/throw_result', 'TextDocument:text')[0]
    assert 'release known before (ms)' in text


def _residuals(twin: Any) -> list[Any]:
    return [outputs.residual for outputs in twin.outputs if outputs.residual]
