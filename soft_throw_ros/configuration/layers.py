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

from soft_throw_ros.configuration import markup
from soft_throw_ros.configuration.table import ParameterError
import yaml

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
class Quantity:
    """
    A property of a material.

    Parameters
    ----------
    value : float
        What to compute with.
    low, high : float
        What its source gives as a range; `value` if it gives none.

    """

    value: float
    low: float
    high: float


@dataclass(frozen=True, kw_only=True)
class Material:
    """
    A material of the library.

    Parameters
    ----------
    name : str
        What it is called.
    description : str
        What it is.
    source : str
        Where the numbers are from.
    density : Quantity
        [kg/m3]
    wave_speed : Quantity
        Of longitudinal waves in a thin bar. [m/s]
    loss_tangent : Quantity
        At the frequency of the plate. [-]
    thicknesses : tuple of float
        In which it comes; if empty, it is cast as wanted. [m]
    diameter : float or None
        In which it comes, if only in one. [m]

    """

    name: str
    description: str
    source: str
    density: Quantity
    wave_speed: Quantity
    loss_tangent: Quantity
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


@dataclass(frozen=True)
class Library:
    """
    Materials by their names, and what choosing a layer's name sets.

    Parameters
    ----------
    materials : mapping of str to Material
        By their names.
    layers : mapping of str to mapping
        Parameters of the twin, by the names that `layer.name` may have.

    """

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
        changed_ns = Path(path).stat().st_mtime_ns
    except OSError as error:
        raise ParameterError(f'{path}: {error.strerror}', 'layer.library') from None
    try:
        return _library(str(path), changed_ns)
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
    root = markup.read(path)
    if root is None:
        raise ParameterError(f'{path}: no material in it')
    seen = set(known)
    for name, node in _items(path, root, 'NAME: {density: ..., ...}'):
        where = markup.place(path, node)
        if not re.fullmatch(r'[A-Za-z0-9][A-Za-z0-9_.-]*', name) or name == CUSTOM:
            raise ParameterError(
                f'{where}: the name of a material is letters, digits, points, dashes and '
                f'underlines, and not {CUSTOM!r}, got {name!r}'
            )
        if name in seen:
            raise ParameterError(f'{where}: there is a material named {name} already')
        seen.add(name)
        yield name, _material(path, name, node)


def _material(path: Path, name: str, node: yaml.Node) -> Material:
    parts = dict(_items(path, node, 'PROPERTY: VALUE'))
    where = markup.place(path, node)
    for key, part in parts.items():
        if key not in _KEYS:
            close = difflib.get_close_matches(key, _KEYS, n=1)
            advice = f'; did you mean {close[0]}?' if close else f'; it has {", ".join(_KEYS)}'
            raise ParameterError(f'{markup.place(path, part)}: no {key!r} in a material{advice}')
    missing = [key for key in _REQUIRED if key not in parts]
    if missing:
        raise ParameterError(f'{where}: {name} has no {", no ".join(missing)}')
    if len([key for key in _STIFFNESS if key in parts]) != 1:
        raise ParameterError(
            f'{where}: {name} must have either wave_speed or youngs_modulus, got '
            f'{"both" if "wave_speed" in parts else "neither"}'
        )
    density = _quantity(path, 'density', parts['density'])
    if 'wave_speed' in parts:
        wave_speed = _quantity(path, 'wave_speed', parts['wave_speed'])
    else:
        modulus = _quantity(path, 'youngs_modulus', parts['youngs_modulus'])
        speeds = (math.sqrt(x / density.value) for x in (modulus.value, modulus.low, modulus.high))
        wave_speed = Quantity(**dict(zip(('value', 'low', 'high'), speeds, strict=True)))
        _check(path, 'wave_speed', wave_speed.value, parts['youngs_modulus'])
    thicknesses: tuple[float, ...] = ()
    if 'thicknesses' in parts:
        thicknesses = tuple(_numbers(path, 'thickness', parts['thicknesses']))
    diameter = parts.get('diameter')
    return Material(
        name=name,
        description=_text(path, 'description', parts['description']),
        source=_text(path, 'source', parts['source']),
        density=density,
        wave_speed=wave_speed,
        loss_tangent=_quantity(path, 'loss_tangent', parts['loss_tangent']),
        thicknesses=thicknesses,
        diameter=None if diameter is None else _number(path, 'diameter', diameter),
    )


def _items(path: Path, node: yaml.Node, form: str) -> Iterator[tuple[str, yaml.Node]]:
    """Yield the keys of a mapping with their values; a key may not come twice."""
    if not isinstance(node, yaml.MappingNode):
        raise ParameterError(
            f'{markup.place(path, node)}: expected {form}, got {markup.value_of(node)!r}'
        )
    seen = set()
    for key, value in node.value:
        name = str(key.value)
        if name in seen:
            raise ParameterError(f'{markup.place(path, key)}: {name} is given twice')
        seen.add(name)
        yield name, value


def _text(path: Path, key: str, node: yaml.Node) -> str:
    value = str(node.value).strip() if isinstance(node, yaml.ScalarNode) else ''
    if not value:
        raise ParameterError(
            f'{markup.place(path, node)}: {key} must be a text, got {markup.value_of(node)!r}'
        )
    return value


def _quantity(path: Path, key: str, node: yaml.Node) -> Quantity:
    """Read a number, or a number and its range."""
    if not isinstance(node, yaml.MappingNode):
        value = _number(path, key, node)
        return Quantity(value=value, low=value, high=value)
    parts = dict(_items(path, node, '{value: ..., range: [..., ...]}'))
    if set(parts) != {'value', 'range'}:
        raise ParameterError(
            f'{markup.place(path, node)}: {key} must be a number or '
            f'{{value: ..., range: [..., ...]}}, got {", ".join(parts) or "nothing"}'
        )
    value = _number(path, key, parts['value'])
    bounds = _numbers(path, key, parts['range'])
    if len(bounds) != 2 or not bounds[0] <= value <= bounds[1]:
        raise ParameterError(
            f'{markup.place(path, parts["range"])}: the range of {key} must be two numbers around '
            f'{value:g}, got {bounds}'
        )
    return Quantity(value=value, low=bounds[0], high=bounds[1])


def _numbers(path: Path, key: str, node: yaml.Node) -> list[float]:
    if not isinstance(node, yaml.SequenceNode) or not node.value:
        raise ParameterError(
            f'{markup.place(path, node)}: expected a list of numbers for {key}, '
            f'got {markup.value_of(node)!r}'
        )
    return [_number(path, key, item) for item in node.value]


def _number(path: Path, key: str, node: yaml.Node) -> float:
    return _check(path, key, markup.value_of(node), node)


def _check(path: Path, key: str, value: object, node: yaml.Node) -> float:
    """Return a number within its bounds, or refuse it."""
    unit, low, high = BOUNDS[key]
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not low <= value <= high:
        raise ParameterError(
            f'{markup.place(path, node)}: {key} must be a number from {low:g} to {high:g}'
            f'{f" {unit}" if unit else ""}, got {value!r}'
        )
    return float(value)
