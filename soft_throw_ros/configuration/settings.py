# SPDX-License-Identifier: Apache-2.0
"""
Settings: a value for every parameter, and how a request changes them.

A request is a handful of parameters to be set at once. Any single change within its range is
accepted, since ROS sets a list one by one; refused are values out of range and contradictions
inside one request.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

from soft_throw_ros.configuration.table import (
    BY_NAME,
    check_value,
    CUSTOM,
    LAYERS,
    ParameterError,
    TABLE,
    Value,
)
from soft_throw_ros.core.rig import Engine, Layer, Projectile, Rig

Settings = Mapping[str, Any]


def defaults() -> dict[str, Value]:
    """Return the settings of the paper's rig; results are no settings."""
    return {entry.name: entry.default for entry in TABLE if not entry.is_result}


def change(settings: Settings, request: Settings) -> dict[str, Value]:
    """
    Return what `request` makes of `settings`: the new values, those it implies included.

    Parameters
    ----------
    settings : mapping of str to value
        The complete settings before; not modified.
    request : mapping of str to value
        What is to be set at once.

    Raises
    ------
    ParameterError
        If a value is refused by `check_value`, or two contradict each other.

    Examples
    --------
    >>> change(defaults(), {'layer.thickness': 0.01})
    {'layer.thickness': 0.01, 'layer.name': 'custom'}

    """
    checked = {name: check_value(name, value) for name, value in request.items()}
    changes = expand(settings, checked)
    check_together({**settings, **changes}, checked.keys())
    return changes


def expand(settings: Settings, changes: Mapping[str, Value]) -> dict[str, Value]:
    """
    Add to `changes` what they imply.

    A layer's name implies the layer's values, and a value that is not the named layer's makes it
    `custom`. Harmonic motion implies no damping, and damping that the motion is underdamped.
    What was asked for is never replaced.
    """
    implied: dict[str, Value] = {}
    if 'layer.name' in changes:
        implied.update(LAYERS.get(str(changes['layer.name']), {}))
    elif _departures(settings['layer.name'], changes):
        implied['layer.name'] = CUSTOM
    motion = changes.get('engine.motion')
    if motion == 'harmonic':
        implied['engine.damping_ratio'] = 0.0
    elif settings['engine.motion'] == 'harmonic':
        if motion == 'underdamped':
            implied['engine.damping_ratio'] = BY_NAME['engine.damping_ratio'].default
        elif changes.get('engine.damping_ratio'):
            implied['engine.motion'] = 'underdamped'
    return {**changes, **{name: implied[name] for name in implied if name not in changes}}


def check_together(settings: Settings, changed: Collection[str]) -> None:
    """
    Refuse contradictions among values that were set at once.

    Parameters
    ----------
    settings : mapping of str to value
        The complete settings after the change.
    changed : collection of str
        What was set at once; a pair counts only if both are in it.

    Raises
    ------
    ParameterError
        Quoting both values.

    """
    if 'layer.name' in changed:
        layer = settings['layer.name']
        for name in _departures(layer, {name: settings[name] for name in changed}):
            raise ParameterError(
                f'{name} of {layer} is {LAYERS[layer][name]:g}, got {settings[name]:g}; '
                f'leave one of the two out, or set layer.name to {CUSTOM!r}',
                name,
                'layer.name',
            )
    if {'engine.motion', 'engine.damping_ratio'} <= set(changed):
        damping = settings['engine.damping_ratio']
        if settings['engine.motion'] == 'harmonic' and damping > 0.0:
            raise ParameterError(
                f"engine.motion 'harmonic' has no damping, got engine.damping_ratio {damping:g}; "
                "leave one of the two out, or set engine.motion to 'underdamped'",
                'engine.damping_ratio',
                'engine.motion',
            )
    for low, high, together in (
        ('recommendation.thickness_min', 'recommendation.thickness_max', False),
        ('recommendation.wave_speed_min', 'recommendation.wave_speed_max', False),
        ('rate.field', 'rate.state', True),
    ):
        if {low, high} <= set(changed):
            smaller, larger = settings[low], settings[high]
            if smaller > larger or (smaller == larger and not together):
                bound = 'at most' if together else 'below'
                raise ParameterError(
                    f'{low} must be {bound} {high}, got {smaller:g} and {larger:g}', low, high
                )


def rig_of(settings: Settings) -> Rig:
    """
    Make the rig that the settings describe.

    Examples
    --------
    >>> rig_of(defaults()) == Rig()
    True

    """
    values = dict(settings)
    if values['engine.motion'] == 'harmonic':
        values['engine.damping_ratio'] = 0.0
    parts: dict[str, dict[str, Any]] = {'engine': {}, 'layer': {}, 'projectile': {}}
    for name, value in values.items():
        group, _, field = name.partition('.')
        if group in parts and name not in ('engine.motion', 'layer.name'):
            parts[group][field] = value
    return Rig(
        engine=Engine(**parts['engine']),
        layer=Layer(**parts['layer']),
        projectile=Projectile(**parts['projectile']),
        gravity=values['gravity'],
    )


def _departures(layer: str, values: Mapping[str, Any]) -> list[str]:
    """Name the values that are not those of the named layer."""
    known = LAYERS.get(layer, {})
    return [name for name, value in known.items() if values.get(name, value) != value]
