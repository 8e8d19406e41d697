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

from soft_throw_ros.configuration import located_yaml
from soft_throw_ros.configuration.located_yaml import Located
from soft_throw_ros.configuration.table import number_of, ParameterError, quote, row, Table
from soft_throw_ros.core.rig import Layer, Stack

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

_MATERIAL = Table(
    node='material',
    entries=(
        row('description', '', 'What it is', kind='a text', pattern=r'.*\S.*'),
        row('source', '', 'Where the numbers are from', kind='a text', pattern=r'.*\S.*'),
        *(
            row(name, 1.0, '', unit=unit, low=low, high=high)
            for name, (unit, low, high) in BOUNDS.items()
            if name != 'thickness'
        ),
        row('stack', '', 'Its sheets', kind='a text', pattern=r'.*\S.*'),
        row('thicknesses', (0.01,), '', unit='m', low=BOUNDS['thickness'][1],
            high=BOUNDS['thickness'][2]),
    ),
)
_SHEET = Table(
    node='sheet',
    entries=tuple(
        row(name, 1.0, '', unit=unit, low=1e-4 if name == 'thickness' else low, high=high)
        for name, (unit, low, high) in BOUNDS.items()
    ),
)
MAX_SHEETS = 200
"""Number of sheets of a stack [-]: the thickest layer has as many of half a millimetre."""

STACKED = ('layer.thickness', 'layer.wave_speed', 'layer.density', 'layer.loss_tangent')
"""Parameters that each sheet of a stack and the whole stack have."""

_DESCRIPTION = ('description', 'source')
_REQUIRED = (*_DESCRIPTION, 'density', 'loss_tangent')
_STACK = (*_DESCRIPTION, 'stack')
_STIFFNESS = ('wave_speed', 'youngs_modulus')
_RANGED = ('density', 'loss_tangent', *_STIFFNESS)


class MaterialProperty(NamedTuple):
    """Nominal value and published range of a material property."""

    value: float
    low: float
    high: float


@dataclass(frozen=True, kw_only=True)
class Material:
    """A material of the library."""

    name: str
    description: str
    source: str  # of the numbers
    density: MaterialProperty  # [kg/m3]
    wave_speed: MaterialProperty  # of longitudinal waves in a thin bar [m/s]
    loss_tangent: MaterialProperty  # at the frequency of the plate [-]
    thicknesses: tuple[float, ...] = ()  # available ones; empty if it is cast in any [m]
    diameter: float | None = None  # if there is only one [m]

    @property
    def settings(self) -> dict[str, float | str]:
        """Parameters of the twin for a layer of this material."""
        values: dict[str, float | str] = {
            'layer.stack': '',
            'layer.wave_speed': self.wave_speed.value,
            'layer.density': self.density.value,
            'layer.loss_tangent': self.loss_tangent.value,
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

    Parameters
    ----------
    text : str
        The sheets.
    materials : callable
        Returns the known materials; called only if a sheet names one.

    Raises
    ------
    ParameterError
        Quoting the sheet that is wrong.

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
        values = {
            name.removeprefix('layer.'): value
            for name, value in known[words[1]].settings.items()
            if name in STACKED
        }
    elif len(words) in (3, 4):
        values = dict(zip(('wave_speed', 'density', 'loss_tangent'), words[1:], strict=False))
    else:
        raise ParameterError(
            'layer.stack: a sheet must be THICKNESS MATERIAL, or THICKNESS WAVE_SPEED DENSITY '
            f'[LOSS_TANGENT], got {quote(" ".join(words))}',
            'layer.stack',
        )
    try:
        checked = {
            name: _SHEET.check_value(name, value)
            for name, value in {'thickness': words[0], **values}.items()
        }
    except ParameterError as error:
        raise ParameterError(f'layer.stack: {error}', 'layer.stack') from None
    return Layer(**checked)  # type: ignore[arg-type]


def default_file() -> Path:
    """Return the path of the library that is installed with the package."""
    return Path(str(resources.files('soft_throw_ros') / 'config' / 'layers.yaml'))


def library(path: str | Path = '') -> Library:
    """
    Return the installed library, with the materials of another file added.

    Parameters
    ----------
    path : path_like
        The other file, read again after a change; empty for the installed library only.

    Raises
    ------
    ParameterError
        If the file cannot be read, or differs from the format in `config/layers.yaml`; the message
        names file and line.

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
    stacks: dict[str, Located] = {}
    for file in (default_file(), *([Path(path)] if path else [])):
        _read_materials(file, materials, stacks)
    layers: dict[str, Mapping[str, float | str]] = {}
    for material in materials.values():
        for thickness in material.thicknesses:
            name = material.layer_name(thickness)
            layers[name] = {'layer.thickness': thickness, **material.settings}
        if not material.thicknesses:
            layers[material.name] = material.settings
    result = Library(MappingProxyType(materials), MappingProxyType(layers))
    for name, node in stacks.items():
        try:
            sheets = read_stack(node.value, lambda: materials)
            layers[name] = {'layer.stack': write_stack(sheets), **whole(sheets)}
        except ParameterError as error:
            raise ParameterError(f'{node.where}: {error}') from None
    return result


def whole(sheets: Sequence[Layer]) -> dict[str, float]:
    """
    Return the values of a whole stack by the names of their parameters.

    Raises
    ------
    ParameterError
        If the stack is too thin or too thick.

    """
    stack = Stack(sheets=tuple(sheets))
    _, low, high = BOUNDS['thickness']
    if not low <= stack.thickness <= high:
        raise ParameterError(
            f'layer.stack must be from {low:g} to {high:g} m thick, got {stack.thickness:g} m',
            'layer.stack',
        )
    return {name: getattr(stack, name.removeprefix('layer.')) for name in STACKED}


def _read_materials(
    path: Path, materials: dict[str, Material], stacks: dict[str, Located]
) -> None:
    """Add the materials and the stacks of a file."""
    root = located_yaml.read(path)
    if root is None:
        raise ParameterError(f'{path}: the file has no material')
    for name, node in _items(root, 'NAME: {density: ..., ...}').items():
        if not re.fullmatch(r'[A-Za-z0-9][A-Za-z0-9_.-]*', name) or name == CUSTOM:
            raise ParameterError(
                f'{node.where}: the name of a material is letters, digits, points, dashes and '
                f'underlines, and not {CUSTOM!r}, got {quote(name)}'
            )
        if name in materials or name in stacks:
            raise ParameterError(f'{node.where}: there is a material named {name} already')
        items = _items(node, 'PROPERTY: VALUE')
        values = {key: _value(key, item) for key, item in items.items()}
        required = _STACK if 'stack' in items else _REQUIRED
        missing = [key for key in required if key not in items]
        if missing:
            raise ParameterError(f'{node.where}: {name} has no {", no ".join(missing)}')
        if 'stack' not in items:
            materials[name] = _material(name, node, items, values)
            continue
        for key, item in items.items():
            if key not in required:
                raise ParameterError(f'{item.where}: a stack has no {key}')
        stacks[name] = items['stack']


def _material(
    name: str, node: Located, items: Mapping[str, Located], values: dict[str, Any]
) -> Material:
    stiffness = [key for key in _STIFFNESS if key in values]
    if len(stiffness) != 1:
        raise ParameterError(
            f'{node.where}: {name} must have either wave_speed or youngs_modulus, got '
            f'{"both" if stiffness else "neither"}'
        )
    modulus = values.pop('youngs_modulus', None)
    if modulus is not None:
        speeds = (math.sqrt(end / values['density'].value) for end in modulus)
        values['wave_speed'] = MaterialProperty(*speeds)
        _checked('wave_speed', values['wave_speed'].value, items['youngs_modulus'].where)
    return Material(name=name, **values)


def _items(node: Located, form: str) -> dict[str, Located]:
    """Return the values of a mapping; a key may not come twice."""
    if node.items is None:
        raise ParameterError(f'{node.where}: expected {form}, got {quote(node.value)}')
    items: dict[str, Located] = {}
    for key, value in node.items:
        if key in items:
            raise ParameterError(f'{value.where}: {key} is given twice')
        items[key] = value
    return items


def _checked(key: str, value: object, where: str) -> Any:
    """Return a value within its bounds, of the type that its row has; or refuse it."""
    try:
        return _MATERIAL.check_value(key, value)
    except ParameterError as error:
        raise ParameterError(f'{where}: {error}') from None


def _value(key: str, node: Located) -> Any:
    """Return the value of a property; some may have a range."""
    if node.items is None or key not in _RANGED:
        value = _checked(key, node.value, node.where)
        return MaterialProperty(value, value, value) if key in _RANGED else value
    items = _items(node, '{value: ..., range: [..., ...]}')
    if set(items) != {'value', 'range'}:
        raise ParameterError(
            f'{node.where}: {key} must be a number or {{value: ..., range: [..., ...]}}, got '
            f'{", ".join(items) or "nothing"}'
        )
    value = _checked(key, items['value'].value, items['value'].where)
    limits, where = items['range'].value, items['range'].where
    ends = [_checked(key, end, where) for end in limits] if isinstance(limits, list) else []
    if len(ends) != 2 or not ends[0] <= value <= ends[1]:
        raise ParameterError(
            f'{where}: the range of {key} must be two numbers around {value:g}, got {limits}'
        )
    return MaterialProperty(value, *ends)
