# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Files of parameters and of layers, and arguments, that are wrong, or nearly right."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

from fuzzing import accepted, bounded, fuzzed, NUMBERS, run, texts, VALUES
from hypothesis import given
from hypothesis import strategies as st
import pytest
from soft_throw_ros.commands import throw
from soft_throw_ros.configuration import files, layers, RECORDER, Settings, Table, TWIN
from soft_throw_ros.configuration.recorder import VIEWER
from soft_throw_ros.configuration.rig import CALIBRATOR, RIG
from soft_throw_ros.configuration.table import ParameterError, quote
from soft_throw_ros.twin.session import Session

TABLES = (TWIN, RECORDER, VIEWER, RIG, CALIBRATOR)
DEFAULTS = layers.default_file().with_name('twin.yaml')
FILES = (DEFAULTS, *sorted(DEFAULTS.parent.glob('*.yaml')))


def assert_valid(table: Table, settings: Settings) -> None:
    """Assert that accepted settings are complete, finite and within their ranges."""
    assert set(settings) == {entry.name for entry in table.entries if not entry.is_result}
    for name, value in settings.items():
        entry = table.by_name[name]
        assert entry.convert(value) == value, name
        assert type(value) is type(entry.default), name
        numbers = value if isinstance(value, tuple) else (value,)
        assert all(math.isfinite(x) for x in numbers if isinstance(x, (int, float))), name


@st.composite
def requests(draw: Any, table: Table) -> dict[str, Any]:
    """Make changes of some parameters: near their limits, of other parameters, or of any kind."""
    names = [entry.name for entry in table.entries]
    request = {}
    for name in draw(st.lists(st.sampled_from(names), min_size=1, max_size=4, unique=True)):
        entry = table.by_name[name]
        near = [entry.default, entry.low, entry.high, *entry.choices]
        near += [math.nextafter(x, draw(st.sampled_from([-math.inf, math.inf])))
                 for x in (entry.low, entry.high)]
        values = st.sampled_from(near) | VALUES
        if math.isfinite(entry.low) and math.isfinite(entry.high):
            values |= st.floats(entry.low, entry.high)
        request[name] = draw(values)
    if draw(st.integers(0, 9)) == 0:
        request[draw(st.text(max_size=8) | st.sampled_from(['', 'layer', 'layer.']))] = 1.0
    return request


@fuzzed(0.2)
@given(data=st.data())
def test_parameters_are_valid_or_refused(tmp_path: Path, data: Any) -> None:
    table = data.draw(st.sampled_from(TABLES))
    request = data.draw(requests(table))

    def change() -> Settings:
        try:
            return {**table.defaults(), **table.change(table.defaults(), request)}
        except ParameterError as error:
            assert any(quote(value) in str(error) or f'{name!r}' in str(error)
                       or (isinstance(value, str)  # a file
                           and any(f'{path}: ' in str(error) for path in (value, value.strip())))
                       or (isinstance(value, (int, float)) and f'{value:g}' in str(error))
                       for name, value in request.items()), str(error)
            raise

    with bounded(tmp_path):
        settings = accepted(change, error=ParameterError)
        if settings is not None:
            assert_valid(table, settings)


@fuzzed(0.02)
@given(data=st.data())
def test_twin_with_any_valid_parameters_has_finite_outputs(tmp_path: Path, data: Any) -> None:
    names = [entry.name for entry in TWIN.entries if entry.is_of_rig and entry.low < entry.high]
    numbers = [name for name in names if math.isfinite(TWIN.by_name[name].high)]
    chosen = data.draw(st.lists(st.sampled_from(numbers), max_size=4, unique=True))
    request = {name: data.draw(st.floats(TWIN.by_name[name].low, TWIN.by_name[name].high))
               for name in chosen}
    with bounded(tmp_path):
        settings = {**TWIN.defaults(), **TWIN.change(TWIN.defaults(), request)}
        session = accepted(lambda: Session({**settings, 'throw.period': 0.05}))
        for _ in range(120 if session else 0):  # or it cannot be stepped in real time
            assert all(map(math.isfinite, session.advance().state)), settings


@fuzzed(0.2)
@given(
    text=texts(*(path.read_text('utf-8') for path in FILES)),
    table=st.sampled_from(TABLES),
    encoding=st.sampled_from(['utf-8', 'utf-8', 'utf-8', 'utf-16', 'latin-1']),
)
def test_file_of_parameters_is_read_or_refused(
    tmp_path: Path, text: str, table: Table, encoding: str
) -> None:
    path = tmp_path / 'file.yaml'
    path.write_bytes(text.encode(encoding, 'replace'))
    with bounded(tmp_path):
        settings = accepted(
            lambda: files.read(path, node=f'/{table.node}', table=table), str(path),
            error=ParameterError,
        )
        if settings is not None:
            assert_valid(table, settings)


@fuzzed(0.05)
@given(
    words=st.lists(
        st.sampled_from(['--ros-args', '-p', '--param', '--params-file', '--', '-r'])
        | texts('layer.thickness:=0.01', 'twin:gravity:=0', '/**:layer.name:=gelatin_2.0mm'),
        max_size=6,
    )
)
def test_ros_arguments_are_taken_or_refused(tmp_path: Path, words: list[str]) -> None:
    def start() -> Settings:
        sources = files.select(files.read_arguments(['--ros-args', *words]), '/twin')
        values = {
            name: item.value if item.in_file else item.where.partition(':=')[2]
            for name, item in sources.items()
        }
        return files.start(values, sources)

    with bounded(tmp_path):
        settings = accepted(start, error=ParameterError)
        if settings is not None:
            assert_valid(TWIN, settings)


@fuzzed(0.1)
@given(text=texts('foam: {description: x, source: y, density: {value: 100, range: [90, 110]}, '
                  'youngs_modulus: 2e4, loss_tangent: 0.1, thicknesses: [0.01, 0.02]}\n',
                  'gel: {description: x, source: y, density: 1e3, wave_speed: 5, '
                  'loss_tangent: 0, diameter: 0.01}\n'))
def test_library_of_layers_is_read_or_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / 'layers.yaml'
    path.write_bytes(text.replace('name', 'mine').encode('utf-8', 'replace'))
    with bounded(tmp_path):
        library = accepted(lambda: layers.library(path), str(path), error=ParameterError)
        for name, values in library.layers.items() if library else ():
            request = {'layer.library': str(path), 'layer.name': name}
            settings = {**TWIN.defaults(), **TWIN.change(TWIN.defaults(), request)}
            assert_valid(TWIN, settings)
            assert values.items() <= settings.items()


OPTIONS = ('--thickness', '--wave-speed', '--density', '--mass', '--frequency', '--amplitude',
           '--damping-ratio', '--gravity', '--loss-tangent', '--max-strain', '--layer',
           '--motion', '--length', '--diameter', '--bogus')


@fuzzed(0.04)
@given(data=st.data())
def test_throw_predicts_or_refuses(tmp_path: Path, data: Any) -> None:
    arguments = ['--json']
    for option in data.draw(st.lists(st.sampled_from(OPTIONS), max_size=4)):
        value = data.draw(st.sampled_from(NUMBERS) | st.floats(1e-4, 100.0).map(repr) | st.text())
        arguments.append(f'{option}={value}')
    with bounded(tmp_path):
        code, out, printed = run(throw.main, arguments)
    if code == 0:
        prediction = json.loads(out, parse_constant=pytest.fail)
        for result in (prediction['throw'], prediction['spring']):
            assert result is None or all(map(math.isfinite, result.values())), out
    else:
        assert code == 2, printed
