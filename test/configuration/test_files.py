# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""ROS parameter files: read, matched, written and refused."""

import re
from typing import Any

from bags import accepted, few, texts
from hypothesis import given, settings
from hypothesis import strategies as st
import pytest
from soft_throw_ros.configuration import files, layers, ParameterError, RECORDER, TWIN
import yaml

DEFAULTS = TWIN.defaults()
INSTALLED = layers.default_file().with_name('twin.yaml')
THIN = {'layer.name': 'gelatin_2.0mm', **layers.library().layers['gelatin_2.0mm']}
THICK = {'layer.name': 'custom', 'layer.thickness': 0.01}


def start(arguments: list[str]) -> dict[str, Any]:
    """Start from arguments as the node does, whose arguments ROS has parsed."""
    sources = files.select(files.read_arguments(arguments), '/twin')
    values = {
        name: item.value if item.in_file else yaml.safe_load(item.where.partition(':=')[2])
        for name, item in sources.items()
    }
    return files.start(values, sources)


@pytest.mark.parametrize('table', [TWIN, RECORDER], ids=lambda table: table.node)
def test_installed_file_gives_the_defaults(table: Any) -> None:
    path = INSTALLED.with_name(f'{table.node}.yaml')
    assert files.read(path, node=f'/rig1/{table.node}', table=table) == table.defaults()


@pytest.mark.parametrize(
    'text',
    [
        'twin: {ros__parameters: {layer: {thickness: 0.01}}}',
        '/twin: {ros__parameters: {layer.thickness: 10e-3}}',
        '/**: {ros__parameters: {layer: {thickness: 1e-2}, use_sim_time: false, folder: bags}}',
        '/**: {ros__parameters: {layer.thickness: 0.02}}\n'
        'twin: {ros__parameters: {layer.thickness: 0.01}}',
        'other: {ros__parameters: {what: [1, 2], who: ~}}\n'
        'twin: {ros__parameters: {layer.thickness: 0.01, use_sim_time: true, '
        'qos_overrides./x.publisher.depth: 7, recommended: {thickness: .nan}}}',
    ],
)
def test_read_finds_the_node_in_every_notation(write: Any, text: str) -> None:
    assert files.read(write(text)) == {**DEFAULTS, **THICK}


@pytest.mark.parametrize(('pattern', 'node', 'matches'), [
    ('/**/twin', '/twin', True), ('/**/twin', '/rig1/sub/twin', True), ('/*', '/twin', True),
    ('/rig1/**', '/rig1/sub/twin', True), ('/*/twin', '/twin', False),
    ('twin', '/rig1/twin', False), ('/a(b', '/twin', False),
])
def test_read_matches_names_as_ros_does(write: Any, pattern, node, matches) -> None:
    path = write(f'{pattern}: {{ros__parameters: {{layer.thickness: 0.01}}}}')
    settings = accepted(lambda: files.read(path, node=node), f'nothing for node {node}')
    assert settings == ({**DEFAULTS, **THICK} if matches else None)


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('twin: {ros__parameters: {layer: {thickness: 16.8}}}', 'layer.thickness .* m, got 16.8'),
        ('twin: {ros__parameters: {layr.name: custom}}', "named 'layr.name'"),
        ('/**/twin: {ros__parameters: {folder: bags}}', "'folder'"),
        ('twin: {layer.thickness: 0.01}', "ros__parameters: NAME: VALUE, got 0.01 as 'layer"),
        ('- 1', 'must be a mapping .* got list'),
        ('twin: &a\n  ros__parameters: *a', 'alias'),
        ('# nothing\n', 'nothing for node /twin; it has no parameters'),
        ('[' * 700, 'nested too deeply'),
        (b'\xff\xfe', 'decode'),
        (None, 'No such file'),
    ],
)
def test_bad_file_is_refused_with_its_name_the_value_and_the_rule(write, text, message) -> None:
    path = write(text or '')
    if text is None:
        path.unlink()
    with pytest.raises(ParameterError, match=message) as refused:
        files.read(path)
    assert str(refused.value).startswith(f'{path}: ')


TEXTS = (
    '/data/run #3/plate.csv', 'a: b', '*x', '[x]', '{x', 'true', 'y', '~', '2e-3', '0x1F', 'nan',
    ' ', "it's", 'a "b"', 'two\nlines', '\x1b[0m', '- x', '\N{MICRO SIGN}m', 100 * 'long ',
)


@settings(few, max_examples=15)
@given(thickness=st.floats(5e-4, 0.1), amplitude=st.floats(1e-5, 0.1))
def test_written_numbers_are_read_back_by_us_and_by_yaml(write, thickness, amplitude) -> None:
    request = {'layer.thickness': thickness, 'engine.amplitude': amplitude, 'throw.max_events': 3}
    values = {**DEFAULTS, **TWIN.change(DEFAULTS, request)}
    path = write(files.render(values, title='Two\n\nlines'))
    assert files.read(path) == values
    everybody = yaml.safe_load(path.read_bytes())['/**/twin']['ros__parameters']
    assert everybody['engine.amplitude'] == amplitude  # and not its text
    path = write(files.render(values, assumed=['layer.thickness']))
    assert files.read(path)['layer.thickness'] == DEFAULTS['layer.thickness']


@pytest.mark.parametrize('text', TEXTS)
def test_written_text_is_read_back_by_us_and_by_yaml(write, text) -> None:
    recorder = {**RECORDER.defaults(), 'folder': text, 'topics': ('/a', 'on')}
    path = write(files.render(recorder, table=RECORDER))
    assert files.read(path, node='/recorder', table=RECORDER) == recorder
    assert yaml.safe_load(path.read_bytes())['/**/recorder']['ros__parameters']['folder'] == text


def test_arguments_are_one_request_after_the_file(write: Any) -> None:
    path = str(INSTALLED)
    later = str(write('twin: {ros__parameters: {layer.name: gelatin_2.0mm}}'))
    thin = ['-p', 'layer.name:=gelatin_2.0mm']
    for arguments, expected in (
        (['--params-file', path, *thin], THIN),
        (['--params-file', path, '--params-file', later], THIN),
        (['--params-file', path, '--param', 'twin:layer.thickness:=1e-2'], THICK),
        (['-p', 'layer.thickness:=0.01', *thin], {**THIN, **THICK}),  # the later in the table
        (['-r', 'a:=b', '--', '-p', 'y:=1'], {}),
    ):
        assert start(['-p', 'x:=1', '--ros-args', *arguments]) == {**DEFAULTS, **expected}


def test_results_and_names_of_others_are_refused_in_arguments_only(write: Any) -> None:
    assert files.start({'recommended.thickness': 0.01}, {}) == DEFAULTS
    shared = ['--params-file', str(write('/**: {ros__parameters: {folder: bags}}'))]
    assert start(['--ros-args', *shared]) == DEFAULTS
    for argument in ('recommended.thickness:=0.01', 'folder:=bags'):
        with pytest.raises(ParameterError, match=rf'^-p {re.escape(argument)}: '):
            start(['--ros-args', *shared, '-p', argument])


OF_TWIN = (  # in all notations of names and values
    '# a rig\n/**/twin:\n  ros__parameters:\n    layer: {name: custom, thickness: 0.01}\n'
    '    engine.frequency: 58.0\n    engine.command: false  # a controller\n'
    '    recommendation.masses: [1.0e-3, 2.0e-3]\n    throw.max_events: 5\n'
    "    layer.stack: '8e-3 gelatin, 2e-3 20 1100'\n    recommended.thickness: .nan\n"
)
FOAM = (
    'foam: {description: x, source: y, density: {value: 100, range: [90, 110]}, '
    'youngs_modulus: 2e4, loss_tangent: 0.1, thicknesses: [0.01, 0.02]}'
)


@few
@given(data=st.data(), encoding=st.sampled_from(['utf-8', 'utf-8', 'utf-16', 'latin-1']))
@pytest.mark.parametrize(('read', 'valid'), [(files.read, OF_TWIN), (layers.library, FOAM)])
def test_damaged_yaml_is_read_or_refused_with_its_name(
    tmp_path, read, valid, data, encoding
) -> None:
    path = tmp_path / 'file.yaml'
    path.write_bytes(data.draw(texts(valid)).encode(encoding, 'replace'))
    result = accepted(lambda: read(path), str(path))
    if read is files.read and result is not None:
        assert result.keys() == DEFAULTS.keys()
        assert all(TWIN.check_value(name, value) == value for name, value in result.items())
