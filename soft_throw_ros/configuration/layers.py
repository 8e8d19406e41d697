# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The library of layers: materials with sourced properties and their available thicknesses.

`config/layers.yaml` documents the format of a file of materials; users can add their own file.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
import math
from pathlib import Path
import re
from typing import Any, NamedTuple

from soft_throw_ros.configuration.table import number_of, ParameterError, quote, row
from soft_throw_ros.configuration.yaml_file import read_yaml
from soft_throw_ros.core.rig import Layer

CUSTOM = 'custom'  # name of a layer that is in no library

# Unit, smallest and largest value of each property of a layer
BOUNDS: Mapping[str, tuple[str, float, float]] = {
    'thickness': ('m', 0.5e-3, 0.1), 'wave_speed': ('m/s', 1.0, 200.0),
    'density': ('kg/m3', 50.0, 5000.0), 'diameter': ('m', 1e-3, 0.2),
    'loss_tangent': ('', 0.0, 2.0), 'youngs_modulus': ('Pa', 50.0, 2e8),
}

_THINNEST_SHEET = 1e-4  # smallest thickness of a sheet [m]
_MAX_SHEETS = 200  # sheets of a stack: the thickest layer has as many of half a millimetre [-]

# Properties that each sheet of a stack and the whole stack have
STACKED = ('thickness', 'wave_speed', 'density', 'loss_tangent')

# Properties of a material in a library: those of every one, and all
_REQUIRED = {'description', 'source', 'density', 'loss_tangent'}
_ALLOWED = _REQUIRED | {*BOUNDS, 'thicknesses', 'is_ideal'} - {'thickness'}


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
        names = (*STACKED[1:], *['diameter'] * bool(self.diameter))
        return {'layer.stack': '', **{f'layer.{name}': getattr(self, name) for name in names}}

    def layer_name(self, thickness: float) -> str:
        """Return the layer's name at a thickness, or the material's name if it is cast to size."""
        if not self.thicknesses:
            return self.name
        text = max(f'{1e3 * thickness:.1f}', f'{1e3 * thickness:g}', key=len)
        return f'{self.name}_{text}mm'


class Library(NamedTuple):
    """Materials by name, and the parameters of the twin that the name of a layer sets."""

    materials: Mapping[str, Material]
    layers: Mapping[str, Mapping[str, float | str]]


def read_stack(text: str, materials: Callable[[], Mapping[str, Material]]) -> list[Layer]:
    """Read the sheets of a stack from the plate up, see the parameter `layer.stack`."""
    if (count := text.count(',') + 1) > _MAX_SHEETS:
        rule = f'must have at most {_MAX_SHEETS} sheets, got {count}'
        raise ParameterError(f'layer.stack {rule}', 'layer.stack')
    try:
        sheets = [_read_sheet(sheet.split(), materials) for sheet in text.split(',')]
        _bounded('thickness', sum(sheet.thickness for sheet in sheets))
    except ParameterError as error:
        raise ParameterError(f'layer.stack: {error}', 'layer.stack') from None
    return sheets


def write_stack(sheets: Sequence[Layer]) -> str:
    """Write the sheets of a stack in numbers, with all their digits."""
    return ', '.join(
        ' '.join(str(float(getattr(sheet, name))) for name in STACKED) for sheet in sheets
    )


def _read_sheet(words: list[str], materials: Callable[[], Mapping[str, Material]]) -> Layer:
    """Read a sheet of a stack."""
    values: Sequence[Any] = words[1:]
    if len(words) == 2 and number_of(words[1]) is None:
        known = materials()
        if words[1] not in known:
            there = f'there are {", ".join(known)}'
            raise ParameterError(f'no material is named {quote(words[1])}; {there}')
        values = [getattr(known[words[1]], name) for name in STACKED[1:]]
    elif len(words) not in (3, 4):
        raise ParameterError(
            'a sheet must be THICKNESS MATERIAL, or THICKNESS WAVE_SPEED DENSITY [LOSS_TANGENT], '
            f'got {quote(" ".join(words))}'
        )
    return Layer(
        thickness=_bounded('thickness', words[0], low=_THINNEST_SHEET),
        **{key: _bounded(key, value) for key, value in zip(STACKED[1:], values, strict=False)},
    )


def _bounded(name: str, value: Any, low: float | None = None) -> Any:
    """Return a property of a layer as a number within its bounds, or refuse it."""
    unit, lowest, high = BOUNDS[name]
    return row(name, 0.0, '', unit, low or lowest, high).check(value)


def default_file() -> Path:
    """Return the path of the library that is installed with the package."""
    return Path(__file__).parents[1] / 'config' / 'layers.yaml'


def library(path: str | Path = '') -> Library:
    """Return the installed library, with the materials of another file, as it is now, added."""
    try:
        changed_ns = Path(path).stat().st_mtime_ns if path else 0
        return _library(str(path), changed_ns)
    except (OSError, ParameterError) as error:
        reason = f'{path}: {error.strerror}' if isinstance(error, OSError) else str(error)
        raise ParameterError(reason, 'layer.library') from None


@lru_cache(maxsize=8)
def _library(path: str, _changed_ns: int) -> Library:
    materials: dict[str, Material] = {}
    layers: dict[str, Mapping[str, float | str]] = {}
    for file in filter(None, (str(default_file()), path)):
        tree = read_yaml(file)
        if not tree:
            raise ParameterError(f'{file}: the file has no material')
        for name, properties in tree.items():
            try:
                material = _material(name, properties, {*materials, *layers})
                materials[name] = material
                for size in material.thicknesses or (None,):
                    own = {} if size is None else {'layer.thickness': size}
                    layers[material.layer_name(size or 0.0)] = {**own, **material.settings}
            except ParameterError as error:
                raise ParameterError(f'{file}: {quote(name)}: {error}') from None
    return Library(materials, layers)


def _material(name: object, values: Any, known: set[str]) -> Material:
    """Return the material of an entry of a library; a range has a value to compute with."""
    is_name = isinstance(name, str) and re.fullmatch(r'[A-Za-z0-9][A-Za-z0-9_.-]*', name)
    if not is_name or name == CUSTOM:
        raise ParameterError(
            f'a name must be letters, digits, points, dashes and underlines, and not {CUSTOM!r}'
        )
    if name in known:
        raise ParameterError('there is a material or layer with this name already')
    if not isinstance(values, dict):
        raise ParameterError(f'must be PROPERTY: VALUE, got {quote(values)}')
    if missing := _REQUIRED - values.keys():
        raise ParameterError(f'{", ".join(sorted(missing))} must be given')
    if unknown := values.keys() - _ALLOWED:
        rule = f'a property must be one of {", ".join(sorted(_ALLOWED))}'
        raise ParameterError(f'{rule}, got {quote(min(unknown, key=str))}')
    if ('wave_speed' in values) == ('youngs_modulus' in values):
        raise ParameterError('either wave_speed or youngs_modulus must be given')
    numbers = {
        key: _bounded(key, item.get('value') if isinstance(item, dict) else item)
        for key, item in values.items() if key in BOUNDS
    }
    if 'youngs_modulus' in numbers:
        speed = math.sqrt(numbers.pop('youngs_modulus') / numbers['density'])
        numbers['wave_speed'] = _bounded('wave_speed', speed)
    if not isinstance(sizes := values.get('thicknesses', []), list):
        raise ParameterError(f'thicknesses must be a list, got {quote(sizes)}')
    numbers['thicknesses'] = tuple(_bounded('thickness', item) for item in sizes)
    return Material(name=str(name), is_ideal=values.get('is_ideal') is True, **numbers)
