# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The library of layers: materials with sourced properties and their available thicknesses.

`config/layers.yaml` documents the format of a file of materials; users can add their own file.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
import math
from pathlib import Path
import re
from types import MappingProxyType
from typing import Any, NamedTuple

from soft_throw_ros.configuration.table import number_of, ParameterError, quote
from soft_throw_ros.configuration.yaml_file import read_yaml
from soft_throw_ros.core.rig import Layer

CUSTOM = 'custom'
"""Name of a layer that is in no library."""

BOUNDS: Mapping[str, tuple[str, float, float]] = MappingProxyType({
    'thickness': ('m', 0.5e-3, 0.1),
    'wave_speed': ('m/s', 1.0, 200.0),
    'density': ('kg/m3', 50.0, 5000.0),
    'diameter': ('m', 1e-3, 0.2),
    'loss_tangent': ('', 0.0, 2.0),
    'youngs_modulus': ('Pa', 50.0, 2e8),
})
"""Unit, smallest and largest value of each property of a layer."""

_THINNEST_SHEET = 1e-4
"""Smallest thickness of a sheet. [m]"""

MAX_SHEETS = 200
"""Number of sheets of a stack [-]: the thickest layer has as many of half a millimetre."""

STACKED = ('layer.thickness', 'layer.wave_speed', 'layer.density', 'layer.loss_tangent')
"""Parameters that each sheet of a stack and the whole stack have."""

_STACK = {'description', 'source', 'stack'}
_MATERIAL = {'description', 'source', 'density', 'loss_tangent'}
_OPTIONAL = {'wave_speed', 'youngs_modulus', 'thicknesses', 'diameter', 'is_ideal'}
"""Properties in a library: of a stack, of every material, and others of a material."""


@dataclass(frozen=True, kw_only=True)
class Material:
    """A material of the library."""

    name: str
    density: float  # [kg/m3]
    wave_speed: float  # of longitudinal waves in a thin bar [m/s]
    loss_tangent: float  # at the frequency of the plate [-]
    thicknesses: tuple[float, ...] = ()  # available ones; empty if it is cast in any [m]
    diameter: float | None = None  # if there is only one [m]
    is_ideal: bool = False  # without the loss of a real material, so not recommended

    @property
    def settings(self) -> dict[str, float | str]:
        """Parameters of the twin for a layer of this material."""
        values: dict[str, float | str] = {
            'layer.stack': '',
            'layer.wave_speed': self.wave_speed,
            'layer.density': self.density,
            'layer.loss_tangent': self.loss_tangent,
        }
        if self.diameter is not None:
            values['layer.diameter'] = self.diameter
        return values

    def layer_name(self, thickness: float) -> str:
        """Return the layer's name at a thickness, or the material's name if it is cast to size."""
        if not self.thicknesses:
            return self.name
        millimetres = 1e3 * thickness
        text = max(f'{millimetres:.1f}', f'{millimetres:g}', key=len)
        return f'{self.name}_{text}mm'


class Library(NamedTuple):
    """Materials by name, and the parameters of the twin that the name of a layer sets."""

    materials: Mapping[str, Material]
    layers: Mapping[str, Mapping[str, float | str]]


def read_stack(text: str, materials: Callable[[], Mapping[str, Material]]) -> list[Layer]:
    """
    Read the sheets of a stack from the plate up, separated by commas.

    A sheet is `THICKNESS MATERIAL`, or `THICKNESS WAVE_SPEED DENSITY` and perhaps its loss
    tangent, in SI units.

    Examples
    --------
    >>> materials = library().materials
    >>> sheets = read_stack('8e-3 gelatin, 2e-3 20 1100 0.1', lambda: materials)
    >>> [sheet.wave_speed for sheet in sheets]
    [7.8, 20.0]
    >>> write_stack(sheets)
    '0.008 7.8 1000.0 0.0, 0.002 20.0 1100.0 0.1'

    """
    count = text.count(',') + 1
    if count > MAX_SHEETS:
        raise ParameterError(
            f'layer.stack must have at most {MAX_SHEETS} sheets, got {count}', 'layer.stack'
        )
    return [_read_sheet(sheet.split(), materials) for sheet in text.split(',')]


def write_stack(sheets: Iterable[Layer]) -> str:
    """Write the sheets of a stack in numbers, with all their digits."""
    return ', '.join(
        ' '.join(str(float(getattr(sheet, name.removeprefix('layer.')))) for name in STACKED)
        for sheet in sheets
    )


def _read_sheet(words: list[str], materials: Callable[[], Mapping[str, Material]]) -> Layer:
    """Read a sheet of a stack."""
    if len(words) == 2 and number_of(words[1]) is None:
        known = materials()
        if words[1] not in known:
            raise ParameterError(
                f'layer.stack: no material is named {quote(words[1])}; there are '
                f'{", ".join(known)}',
                'layer.stack',
            )
        material = known[words[1]]
        values: list[Any] = [material.wave_speed, material.density, material.loss_tangent]
    elif len(words) in (3, 4):
        values = list(words[1:])
    else:
        raise ParameterError(
            'layer.stack: a sheet must be THICKNESS MATERIAL, or THICKNESS WAVE_SPEED DENSITY '
            f'[LOSS_TANGENT], got {quote(" ".join(words))}',
            'layer.stack',
        )
    names = ('wave_speed', 'density', 'loss_tangent')
    try:
        thickness = _bounded('thickness', words[0], low=_THINNEST_SHEET)
        properties: dict[str, Any] = {
            name: _bounded(name, value) for name, value in zip(names, values, strict=False)
        }
    except ParameterError as error:
        raise ParameterError(f'layer.stack: {error}', 'layer.stack') from None
    return Layer(thickness=thickness, **properties)


def _bounded(name: str, value: Any, low: float | None = None) -> float:
    """Return a property of a layer as a number within its bounds, or refuse it."""
    unit, lowest, high = BOUNDS[name]
    lowest = lowest if low is None else low
    number: Any = number_of(value) if isinstance(value, str) else value
    is_number = isinstance(number, (int, float)) and not isinstance(number, bool)
    if is_number and lowest <= number <= high:
        return float(number)
    rule = f'a number from {lowest:g} to {high:g} {unit}'.strip()
    raise ParameterError(f'{name} must be {rule}, got {quote(value)}')


def default_file() -> Path:
    """Return the path of the library that is installed with the package."""
    return Path(str(resources.files('soft_throw_ros') / 'config' / 'layers.yaml'))


def library(path: str | Path = '') -> Library:
    """
    Return the installed library, with the materials of another file added.

    The other file is read again after a change.
    """
    if not str(path):
        return _library('', 0)
    try:
        return _library(str(path), Path(path).stat().st_mtime_ns)
    except OSError as error:
        raise ParameterError(f'{path}: {error.strerror}', 'layer.library') from None
    except ParameterError as error:
        raise ParameterError(str(error), 'layer.library') from None


@lru_cache(maxsize=8)
def _library(path: str, _changed_ns: int) -> Library:
    materials: dict[str, Material] = {}
    layers: dict[str, Mapping[str, float | str]] = {}
    for file in (default_file(), *([Path(path)] if path else [])):
        tree = read_yaml(file)
        if not tree:
            raise ParameterError(f'{file}: the file has no material')
        stacks = [key for key, item in tree.items() if isinstance(item, dict) and 'stack' in item]
        for name in sorted(tree, key=stacks.__contains__):  # materials first
            try:
                _check_entry(name, tree[name], {*materials, *layers})
                if name in stacks:
                    sheets = read_stack(str(tree[name]['stack']), lambda: materials)
                    layers[name] = {'layer.stack': write_stack(sheets), **whole(sheets)}
                else:
                    materials[name] = _material(name, tree[name])
                    layers |= _layers_of(materials[name])
            except ParameterError as error:
                raise ParameterError(f'{file}: {quote(name)}: {error}') from None
    return Library(MappingProxyType(materials), MappingProxyType(layers))


def _layers_of(material: Material) -> dict[str, Mapping[str, float | str]]:
    """Return the settings of the layers of a material by name."""
    if not material.thicknesses:
        return {material.name: material.settings}
    return {
        material.layer_name(thickness): {'layer.thickness': thickness, **material.settings}
        for thickness in material.thicknesses
    }


def whole(sheets: Sequence[Layer]) -> dict[str, float]:
    """Return the values of a whole stack by the names of their parameters."""
    stack = Layer.of_sheets(sheets)
    _, low, high = BOUNDS['thickness']
    if not low <= stack.thickness <= high:
        raise ParameterError(
            f'layer.stack must be from {low:g} to {high:g} m thick, got {stack.thickness:g} m',
            'layer.stack',
        )
    return {name: getattr(stack, name.removeprefix('layer.')) for name in STACKED}


def _check_entry(name: object, values: Any, known: set[str]) -> None:
    """Refuse an entry of a library with a wrong name, or wrong names of properties."""
    is_name = isinstance(name, str) and re.fullmatch(r'[A-Za-z0-9][A-Za-z0-9_.-]*', name)
    if not is_name or name == CUSTOM:
        raise ParameterError(
            f'a name must be letters, digits, points, dashes and underlines, and not {CUSTOM!r}'
        )
    if name in known:
        raise ParameterError('there is a material or layer with this name already')
    if not isinstance(values, dict):
        raise ParameterError(f'must be PROPERTY: VALUE, got {quote(values)}')
    is_stack = 'stack' in values
    required, allowed = (_STACK, _STACK) if is_stack else (_MATERIAL, _MATERIAL | _OPTIONAL)
    if missing := required - values.keys():
        raise ParameterError(f'{", ".join(sorted(missing))} must be given')
    if unknown := values.keys() - allowed:
        name = quote(min(unknown, key=str))
        raise ParameterError(f'a property must be one of {", ".join(sorted(allowed))}, got {name}')


def _material(name: str, values: Mapping[str, Any]) -> Material:
    """Return the material with the properties of an entry."""
    if ('wave_speed' in values) == ('youngs_modulus' in values):
        raise ParameterError('either wave_speed or youngs_modulus must be given')
    density = _property(values, 'density')
    if 'wave_speed' in values:
        speed = _property(values, 'wave_speed')
    else:
        speed = math.sqrt(_property(values, 'youngs_modulus') / density)
    thicknesses = values.get('thicknesses', [])
    if not isinstance(thicknesses, list):
        raise ParameterError(f'thicknesses must be a list, got {quote(thicknesses)}')
    return Material(
        name=name,
        density=density,
        wave_speed=_bounded('wave_speed', speed),
        loss_tangent=_property(values, 'loss_tangent'),
        thicknesses=tuple(_bounded('thickness', item) for item in thicknesses),
        diameter=_property(values, 'diameter') if 'diameter' in values else None,
        is_ideal=values.get('is_ideal') is True,
    )


def _property(values: Mapping[str, Any], name: str) -> float:
    """Return a property, or its value if the source gives a range."""
    item = values[name]
    return _bounded(name, item.get('value') if isinstance(item, dict) else item)
