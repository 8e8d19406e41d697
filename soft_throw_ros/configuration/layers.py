# SPDX-License-Identifier: Apache-2.0
"""
The library of layers: materials with sourced properties, and the layers that they come in.

`config/layers.yaml` says what a file of materials looks like; users add one of their own.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
import difflib
from functools import lru_cache
from importlib import resources
import math
from pathlib import Path
import re
from types import MappingProxyType
from typing import NamedTuple

from soft_throw_ros.configuration import located_yaml
from soft_throw_ros.configuration.located_yaml import Located
from soft_throw_ros.configuration.table import ParameterError, row

CUSTOM = 'custom'
"""Name of a layer that is in no library."""

BOUNDS: Mapping[str, tuple[str, float, float]] = MappingProxyType({
    'thickness': ('m', 0.5e-3, 0.1),
    'wave_speed': ('m/s', 1.0, 200.0),
    'density': ('kg/m3', 50.0, 5000.0),
    'diameter': ('m', 1e-3, 0.2),
    'loss_tangent': ('', 0.0, 2.0),
    'youngs_modulus': ('Pa', 50.0, 2e8),
})  # fmt: skip
"""Units of what describes a layer, and what it may be at least and at most."""

_REQUIRED = ('description', 'source', 'density', 'loss_tangent')
_STIFFNESS = ('wave_speed', 'youngs_modulus')
_KEYS = (*_REQUIRED, *_STIFFNESS, 'thicknesses', 'diameter')


@dataclass(frozen=True, kw_only=True)
class MaterialProperty:
    """What to compute with, and the range that its source gives, or the value if it gives none."""

    value: float
    low: float
    high: float


@dataclass(frozen=True, kw_only=True)
class Material:
    """
    A material of the library.

    Parameters
    ----------
    name, description, source : str
        What it is called, what it is, and where the numbers are from.
    density, wave_speed, loss_tangent : MaterialProperty
        [kg/m3]; of longitudinal waves in a thin bar [m/s]; at the frequency of the plate [-].
    thicknesses : tuple of float
        In which it comes; if empty, it is cast as wanted. [m]
    diameter : float or None
        In which it comes, if only in one. [m]

    """

    name: str
    description: str
    source: str
    density: MaterialProperty
    wave_speed: MaterialProperty
    loss_tangent: MaterialProperty
    thicknesses: tuple[float, ...] = ()
    diameter: float | None = None

    @property
    def settings(self) -> dict[str, float]:
        """Parameters of the twin that say that a layer is of this material."""
        values = {
            'layer.wave_speed': self.wave_speed.value,
            'layer.density': self.density.value,
            'layer.loss_tangent': self.loss_tangent.value,
        }
        if self.diameter is not None:
            values['layer.diameter'] = self.diameter
        return values

    def layer_name(self, thickness: float) -> str:
        """Name the layer of a thickness in which it comes; itself if it is cast as wanted."""
        if not self.thicknesses:
            return self.name
        millimetres = 1e3 * thickness
        text = f'{millimetres:.1f}'
        if not math.isclose(float(text), millimetres, rel_tol=1e-9):
            text = f'{millimetres:g}'
        return f'{self.name}_{text}mm'


class Library(NamedTuple):
    """Materials by name, and which parameters of the twin choosing a layer's name sets."""

    materials: Mapping[str, Material]
    layers: Mapping[str, Mapping[str, float]]


def default_file() -> Path:
    """Return the path of the library that is installed with the package."""
    return Path(str(resources.files('soft_throw_ros') / 'config' / 'layers.yaml'))


def library(path: str | Path = '') -> Library:
    """
    Return the installed library, with the materials of another file added.

    Parameters
    ----------
    path : path_like
        Of the other file, read again when it has changed; empty if there is none.

    Raises
    ------
    ParameterError
        Naming file and line, if the file cannot be read, or something in it is not as
        `config/layers.yaml` says.

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
    materials = dict(_materials(default_file(), {}))
    if path:
        materials.update(_materials(Path(path), materials))
    layers: dict[str, Mapping[str, float]] = {}
    for material in materials.values():
        for thickness in material.thicknesses:
            name = material.layer_name(thickness)
            layers[name] = {'layer.thickness': thickness, **material.settings}
        if not material.thicknesses:
            layers[material.name] = material.settings
    return Library(MappingProxyType(materials), MappingProxyType(layers))


def _materials(path: Path, known: Mapping[str, Material]) -> Iterator[tuple[str, Material]]:
    """Read the materials of a file one after another."""
    root = located_yaml.read(path)
    if root is None:
        raise ParameterError(f'{path}: no material in it')
    for name, node in _parts(root, 'NAME: {density: ..., ...}').items():
        if not re.fullmatch(r'[A-Za-z0-9][A-Za-z0-9_.-]*', name) or name == CUSTOM:
            raise ParameterError(
                f'{node.where}: the name of a material is letters, digits, points, dashes and '
                f'underlines, and not {CUSTOM!r}, got {name!r}'
            )
        if name in known:
            raise ParameterError(f'{node.where}: there is a material named {name} already')
        yield name, _material(name, node)


def _material(name: str, node: Located) -> Material:
    parts = _parts(node, 'PROPERTY: VALUE')
    for key, part in parts.items():
        if key not in _KEYS:
            close = difflib.get_close_matches(key, _KEYS, n=1)
            advice = f'did you mean {close[0]}?' if close else f'it has {", ".join(_KEYS)}'
            raise ParameterError(f'{part.where}: no {key!r} in a material; {advice}')
    missing = [key for key in _REQUIRED if key not in parts]
    if missing:
        raise ParameterError(f'{node.where}: {name} has no {", no ".join(missing)}')
    stiffness = [key for key in _STIFFNESS if key in parts]
    if len(stiffness) != 1:
        raise ParameterError(
            f'{node.where}: {name} must have either wave_speed or youngs_modulus, got '
            f'{"both" if stiffness else "neither"}'
        )
    properties = {
        key: _property(key, parts[key]) for key in ('density', 'loss_tangent', *stiffness)
    }
    modulus = properties.pop('youngs_modulus', None)
    if modulus is not None:
        value, low, high = (
            math.sqrt(each / properties['density'].value)
            for each in (modulus.value, modulus.low, modulus.high)
        )
        _number('wave_speed', value, parts['youngs_modulus'])
        properties['wave_speed'] = MaterialProperty(value=value, low=low, high=high)
    width = parts.get('diameter')
    return Material(
        name=name,
        description=_text('description', parts['description']),
        source=_text('source', parts['source']),
        thicknesses=_numbers('thickness', parts['thicknesses']) if 'thicknesses' in parts else (),
        diameter=None if width is None else _number('diameter', width.value, width),
        **properties,
    )


def _parts(node: Located, form: str) -> dict[str, Located]:
    """Return the values of a mapping; a key may not come twice."""
    if node.items is None:
        raise ParameterError(f'{node.where}: expected {form}, got {node.value!r}')
    parts: dict[str, Located] = {}
    for key, value in node.items:
        if key in parts:
            raise ParameterError(f'{value.where}: {key} is given twice')
        parts[key] = value
    return parts


def _text(key: str, node: Located) -> str:
    if not isinstance(node.value, str) or not node.value.strip():
        raise ParameterError(f'{node.where}: {key} must be a text, got {node.value!r}')
    return node.value.strip()


def _property(key: str, node: Located) -> MaterialProperty:
    """Read a number, or a number and its range."""
    if node.items is None:
        value = _number(key, node.value, node)
        return MaterialProperty(value=value, low=value, high=value)
    parts = _parts(node, '{value: ..., range: [..., ...]}')
    if set(parts) != {'value', 'range'}:
        raise ParameterError(
            f'{node.where}: {key} must be a number or {{value: ..., range: [..., ...]}}, got '
            f'{", ".join(parts) or "nothing"}'
        )
    value = _number(key, parts['value'].value, node)
    bounds = _numbers(key, parts['range'])
    if len(bounds) != 2 or not bounds[0] <= value <= bounds[1]:
        raise ParameterError(
            f'{node.where}: the range of {key} must be two numbers around {value:g}, got '
            f'{list(bounds)}'
        )
    return MaterialProperty(value=value, low=bounds[0], high=bounds[1])


def _numbers(key: str, node: Located) -> tuple[float, ...]:
    if not isinstance(node.value, list) or not node.value:
        raise ParameterError(
            f'{node.where}: expected a list of numbers for {key}, got {node.value!r}'
        )
    return tuple(_number(key, item, node) for item in node.value)


def _number(key: str, value: object, node: Located) -> float:
    """Return a number within its bounds, or refuse it."""
    unit, low, high = BOUNDS[key]
    entry = row(key, low, '', unit=unit, low=low, high=high)
    number = entry.convert(value)
    if not isinstance(number, float):
        raise ParameterError(f'{node.where}: {key} must be {entry.rule}, got {value!r}')
    return number
