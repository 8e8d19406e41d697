# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
from pathlib import Path
import re
from typing import Any

from damage import accepted, few, texts
from hypothesis import given, settings
from hypothesis import strategies as st
import pytest
from soft_throw_ros.configuration import files, layers, ParameterError, RECORDER, TWIN
import yaml


def read_one(path: Path, name: str = 'layer.thickness', node: str = '/twin') -> Any:
    return files.read(path, node=node)[name]


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
    path = layers.default_file().with_name(f'{table.node}.yaml')
    assert files.read(path, node=f'/rig1/{table.node}', table=table) == table.defaults()


@pytest.mark.parametrize(
    'text',
    [
        'twin: {ros__parameters: {layer: {thickness: 0.01}}}',
        '/twin: {ros__parameters: {layer.thickness: 10e-3}}',
        '/**: {ros__parameters: {layer: {thickness: 1e-2}}}',
        '/**/twin: {ros__parameters: {layer: {thickness: 0.01}}}',
        '/*: {ros__parameters: {layer: {thickness: 0.01}}}',
        '/**: {ros__parameters: {layer.thickness: 0.02}}\n'
        'twin: {ros__parameters: {layer.thickness: 0.01}}',
        'other: {ros__parameters: {what: [1, 2], who: ~}}\n'
        'twin: {ros__parameters: {layer.thickness: 0.01, use_sim_time: true, '
        'qos_overrides./x.publisher.depth: 7, recommended: {thickness: .nan}}}',
    ],
)
def test_read_finds_the_node_in_every_notation(write: Any, text: str) -> None:
    expected = {**TWIN.defaults(), 'layer.thickness': 0.01, 'layer.name': 'custom'}
    assert files.read(write(text)) == expected


@pytest.mark.parametrize(
    ('pattern', 'node', 'matches'),
    [
        ('/*/twin', '/rig1/twin', True),
        ('/*/twin', '/twin', False),
        ('/rig1/*', '/rig1/sub/twin', False),
        ('/rig1/**', '/rig1/sub/twin', True),
        ('twin', '/rig1/twin', False),
        ('/twin', '/twin2', False),
        ('/a(b', '/twin', False),
    ],
)
def test_read_matches_names_as_ros_does(
    write: Any, pattern: str, node: str, matches: bool
) -> None:
    path = write(f'{pattern}: {{ros__parameters: {{layer.thickness: 0.01}}}}')
    if matches:
        assert read_one(path, node=node) == 0.01
    else:
        with pytest.raises(ParameterError, match=re.escape(f'nothing for node {node}')):
            files.read(path, node=node)


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('twin: {ros__parameters: {layer: {thickness: 16.8}}}', 'layer.thickness .* m, got 16.8'),
        ('/**: {ros__parameters: {layer: {thickness: 16.8}}}', 'layer.thickness .* m, got 16.8'),
        ('twin: {ros__parameters: {layr.name: custom}}', "named 'layr.name'"),
        ('/**/twin: {ros__parameters: {folder: bags}}', "'folder'"),
        ('twin: {ros__parameters: {layer.thickness: [1, 2]}}', r'got \[1, 2\]'),
        ('twin: {ros__parameters: {layer.thickness: 2026-01-01}}', 'layer.thickness must be'),
        ('twin: {layer.thickness: 0.01}', "ros__parameters: NAME: VALUE, got 0.01 as 'layer"),
        ('twin: {ros__parameters: 3}', "got 3 as 'ros__parameters'"),
        ('- 1', 'must be a mapping .* got list'),
        ('twin:\n\tros__parameters: 1', 'cannot start any token .* line 2'),
        ('twin: {ros__parameters: {a: [', 'expected the node content'),
        ('twin: &a\n  ros__parameters: *a', 'alias'),
    ],
)
def test_bad_file_is_refused_with_its_name_the_value_and_the_rule(
    write: Any, text: str, message: str
) -> None:
    path = write(text)
    with pytest.raises(ParameterError, match=message) as refused:
        files.read(path)
    assert str(refused.value).startswith(f'{path}: ')
    assert '\n' not in str(refused.value)


SHARED = """\
/**:
  ros__parameters:
    use_sim_time: false
    layer.thickness: 0.0123
    folder: bags
"""


def test_parameters_of_other_nodes_below_a_wildcard_are_ignored(write: Any) -> None:
    path = write(SHARED)
    assert files.read(path)['layer.thickness'] == 0.0123
    recorder = files.read(path, node='/recorder', table=RECORDER)
    assert recorder == {**RECORDER.defaults(), 'folder': 'bags'}
    with pytest.raises(ParameterError, match="'folder'"):
        start(['--ros-args', '--params-file', str(path), '-p', 'folder:=bags'])


@pytest.mark.parametrize(
    ('line', 'implied'),
    [
        ('layer: {name: gelatin_2.0mm}', {'layer.thickness': 0.002}),
        ('layer: {thickness: 0.01}', {'layer.name': 'custom'}),
        ('layer: {stack: 8e-3 gelatin}', {'layer.thickness': 0.008}),
        ('engine: {motion: harmonic}', {}),
        ('recommendation: {target_speed: 2.0}', {'recommendation.target_height': 0.0}),
    ],
)
def test_one_line_of_a_complete_file_can_be_edited(
    tmp_path: Path, line: str, implied: dict[str, Any]
) -> None:
    path = tmp_path / 'edited.yaml'
    tree = yaml.safe_load(layers.default_file().with_name('twin.yaml').read_text())
    ((group, change),) = yaml.safe_load(line).items()
    tree['/**/twin']['ros__parameters'][group] |= change
    path.write_text(yaml.safe_dump(tree, sort_keys=False))
    settings = files.read(path)
    for name, value in change.items():
        expected = '0.008 7.8 1000.0 0.0' if name == 'stack' else value
        assert settings[f'{group}.{name}'] == expected
    assert implied.items() <= settings.items()


def test_impossible_file_name_is_refused() -> None:
    with pytest.raises(ParameterError, match='null'):
        files.read(Path('a\0b'))


@pytest.mark.parametrize('content', [None, b'\xff\xfe', b'\x00', b'', b'# nothing\n', b'[' * 2000])
def test_read_refuses_a_file_without_parameters(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / 'twin.yaml'
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(ParameterError, match=f'^{re.escape(str(path))}: '):
        files.read(path)


@settings(max_examples=30)
@given(data=st.data())
def test_written_file_is_read_back_by_us_and_by_yaml(tmp_path_factory: Any, data: Any) -> None:
    path = tmp_path_factory.getbasetemp() / 'written.yaml'
    thickness = data.draw(st.floats(5e-4, 0.1))
    amplitude = data.draw(st.floats(1e-5, 0.1))
    request = {'layer.thickness': thickness, 'engine.amplitude': amplitude, 'throw.max_events': 3}
    settings = {**TWIN.defaults(), **TWIN.change(TWIN.defaults(), request)}
    path.write_text(files.render(settings, title='Two\n\nlines'), 'utf-8')
    assert files.read(path) == settings
    everybody = yaml.safe_load(path.read_text('utf-8'))['/**/twin']['ros__parameters']
    assert everybody['engine']['amplitude'] == amplitude  # and not its text
    assert everybody['layer']['thickness'] == thickness
    path.write_text(files.render(settings, assumed=['layer.thickness']), 'utf-8')
    assert files.read(path)['layer.thickness'] == TWIN.defaults()['layer.thickness']


TEXTS = (
    '/data/run #3/plate.csv', 'a: b', '*x', '[x]', '{x', 'true', 'y', '~', '2e-3', '0x1F', 'nan',
    ' ', "it's", 'a "b"', 'two\nlines', '\x1b[0m', '- x', '\N{MICRO SIGN}m', 100 * 'long ',
)


@pytest.mark.parametrize('text', TEXTS)
def test_texts_are_written_so_that_they_are_read_back(tmp_path: Path, text: str) -> None:
    path = tmp_path / 'written.yaml'
    settings = {**TWIN.defaults(), 'layer.library': text}
    path.write_text(files.render(settings), 'utf-8')
    layer = yaml.safe_load(path.read_text('utf-8'))['/**/twin']['ros__parameters']['layer']
    assert layer['library'] == text
    recorder = {**RECORDER.defaults(), 'name': text, 'topics': ('/a', 'on')}
    path.write_text(files.render(recorder, table=RECORDER), 'utf-8')
    assert files.read(path, node='/recorder', table=RECORDER) == recorder


def test_arguments_are_one_request_after_the_file(write: Any) -> None:
    path = str(layers.default_file().with_name('twin.yaml'))
    named = start(['twin', '--ros-args', '--params-file', path, '-p', 'layer.name:=gelatin_2.0mm'])
    thin = layers.library().layers['gelatin_2.0mm']
    assert named == {**TWIN.defaults(), 'layer.name': 'gelatin_2.0mm', **thin}
    thick = start(['--ros-args', '--params-file', path, '--param', 'twin:layer.thickness:=1e-2'])
    assert thick == {**TWIN.defaults(), 'layer.name': 'custom', 'layer.thickness': 0.01}
    later = write('twin: {ros__parameters: {layer.name: gelatin_2.0mm}}')
    assert named == start(['--ros-args', '--params-file', path, '--params-file', str(later)])


def test_later_of_two_arguments_in_the_table_wins() -> None:
    settings = start(
        ['--ros-args', '-p', 'layer.thickness:=0.01', '-p', 'layer.name:=gelatin_2.0mm']
    )
    assert (settings['layer.name'], settings['layer.thickness']) == ('custom', 0.01)


def test_results_are_ignored_except_in_arguments() -> None:
    result = {'recommended.thickness': 0.01}
    assert files.start(result, {}) == TWIN.defaults()
    with pytest.raises(ParameterError, match=r'^-p recommended\.thickness:=0\.01: '):
        start(['--ros-args', '-p', 'recommended.thickness:=0.01'])


def test_arguments_outside_ros_args_are_ignored() -> None:
    assert start(['-p', 'x:=1', '--ros-args', '-r', 'a:=b', '--', '-p', 'y:=1']) == TWIN.defaults()


CONFIG = [path.read_text('utf-8') for path in layers.default_file().parent.glob('[!l]*.yaml')]
FOAM = (
    'foam: {description: x, source: y, density: {value: 100, range: [90, 110]}, '
    'youngs_modulus: 2e4, loss_tangent: 0.1, thicknesses: [0.01, 0.02]}'
)


@few
@given(data=st.data(), encoding=st.sampled_from(['utf-8', 'utf-8', 'utf-16', 'latin-1']))
@pytest.mark.parametrize(('read', 'valid'), [(files.read, CONFIG), (layers.library, [FOAM])])
def test_damaged_yaml_is_read_or_refused_with_its_name(
    tmp_path: Path, read: Any, valid: list[str], data: Any, encoding: str
) -> None:
    path = tmp_path / 'file.yaml'
    path.write_bytes(data.draw(texts(*valid)).encode(encoding, 'replace'))
    result = accepted(lambda: read(path), str(path))
    if read is files.read and result is not None:
        assert result.keys() == TWIN.defaults().keys()
        assert all(TWIN.check_value(name, value) == value for name, value in result.items())
