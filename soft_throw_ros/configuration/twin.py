# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The parameters of the twin, and the rig that they describe."""

from __future__ import annotations

from dataclasses import fields, replace
import math
from typing import Any

from soft_throw_ros.configuration import layers, motions
from soft_throw_ros.configuration.interface import JOINTS
from soft_throw_ros.configuration.layers import BOUNDS, CUSTOM, library, STACKED
from soft_throw_ros.configuration.table import ParameterError, quote, row, Scalar, Settings, Table
from soft_throw_ros.core.material import LOSSES, STRESS_STRAIN_LAWS
from soft_throw_ros.core.rig import Engine, Layer, Projectile, Rig

_INSTALLED = library()

_STACKED = tuple(f'layer.{name}' for name in STACKED)
# Parameters that the name of a layer may set, and the library that has the name
_NAMED = (*_STACKED, 'layer.diameter', 'layer.stack', 'layer.library')
_TARGETS = ('recommendation.target_height', 'recommendation.target_speed')  # of which one is 0

JOINT_ROWS = tuple(
    row(f'joint_names.{body}', body, f'Name of the {body} in all messages with joints',
        kind='a text of at least one character', pattern='.+', is_fixed=True)
    for body in JOINTS
)
"""Rows of the names of the joints."""

_ENTRIES = (
    row('engine.motion_file', '',
        'File of a motion of the plate, CSV of time and height, which a measured plate is '
        'expected to follow; frequency and amplitude are then units',
        kind='the path of a file, or empty'),
    row('engine.motion', 'underdamped',
        'Motion of the plate: a damped step (D2), A (1 - cos wt) without damping (Eq. 1), that '
        'of `engine.motion_file`, or that measured in `~/measured_joint_states`',
        choices=('underdamped', 'harmonic', 'file', 'measured')),
    row('engine.command', False,
        'Publish the motion of `engine.motion_file` before each throw, for a controller; it '
        'begins and ends at rest at the same height, and `time_scale` is 1'),
    row('engine.command_lead', 0.2,
        'Time from this message to the motion, up to `throw.period` / 4', 's', 0.01, 10.0),
    row('engine.frequency', Engine.frequency, 'Natural frequency of the plate', 'Hz', 1.0, 1000.0),
    row('engine.amplitude', Engine.amplitude, 'Height A where the plate settles', 'm', 1e-5, 0.1),
    row('engine.damping_ratio', Engine.damping_ratio,
        'Damping ratio of the plate, unless the motion is harmonic', '', 0.0, 0.99),
    row('measured.smoothing_window', 2e-3,
        'Smoothing window of a measured plate; half of it delays the events', 's', 1e-4, 0.1),
    row('measured.latency', 0.0, 'Time to wait for samples out of order', 's', 0.0, 0.1),
    row('measured.position_noise', 5e-6, 'Standard deviation of the heights', 'm', 1e-9, 1e-2),
    row('measured.stamp_error', 1e-5, 'Standard deviation of the stamps', 's', 0.0, 1e-3),
    row('measured.residual_threshold', 1e-4,
        'Rms residual beyond which the model is reported as wrong', 'm', 1e-7, 1.0),
    row('layer.library', '',
        'File of materials besides those of `config/layers.yaml`, which describes the format',
        kind='the path of a file, or empty'),
    row('layer.name', 'gelatin_16.8mm',
        'Layer of the library, which sets the values of the layer; `custom` after other changes',
        kind='a name in the library, or `custom`', examples=tuple(_INSTALLED.layers)),
    row('layer.thickness', Layer.thickness, 'Thickness L_s', *BOUNDS['thickness']),
    row('layer.wave_speed', Layer.wave_speed,
        'Wave speed c_s; the modulus is density times its square', *BOUNDS['wave_speed']),
    row('layer.density', Layer.density, 'Density rho_s of the layer', *BOUNDS['density']),
    row('layer.diameter', Layer.diameter, 'Diameter of the layer', *BOUNDS['diameter']),
    row('layer.loss_tangent', Layer.loss_tangent,
        "Loss tangent of the layer at the plate's frequency", *BOUNDS['loss_tangent']),
    row('layer.stack', '',
        'Sheets of the layer from the plate up, separated by commas: each is thickness and '
        'material, or thickness, wave speed, density and perhaps loss tangent, as it is stored; '
        'the values of the layer then describe the whole stack',
        kind='sheets, as in `8e-3 gelatin, 2e-3 20 1100`, or empty'),
    row('layer.stress_strain_law', Layer.stress_strain_law,
        'Stress over strain: in proportion, or as in a neo-Hookean rod, which stiffens where it '
        'is compressed', choices=STRESS_STRAIN_LAWS),
    row('layer.loss', Layer.loss,
        'Loss tangent over frequency: growing (Kelvin and Voigt), or constant, as in gels',
        choices=LOSSES),
    row('projectile.mass', Projectile.mass, 'Mass m of the projectile', 'kg', 1e-5, 1.0),
    row('projectile.length', Projectile.length, 'Length L_r of the projectile, for pictures',
        'm', 1e-4, 0.5),
    row('gravity', Rig.gravity, 'Gravity, towards the plate', 'm/s2', 0.0, 30.0),
    row('throw.period', 1.0, 'Time from one throw to the next; 0 throws only when asked',
        's', 0.05, 3600.0, or_zero=True),
    row('throw.max_events', 20, 'Contacts after which a throw is over', '', 1, 1000),
    row('rate.state', 1000.0, 'Rate of `~/joint_states`', 'Hz', 10.0, 5000.0),
    row('rate.field', 50.0, 'Rate of `~/layer/joint_states`, up to rate.state', 'Hz', 0.1, 1000.0),
    *JOINT_ROWS,
    row('time_scale', 1.0, 'Rig time over clock time; 0.01 is slow motion', '', 1e-4, 10.0),
    row('uncertainty.wave_speed', 0.3,
        'Largest error of the wave speed; all errors up to it are equally likely',
        'm/s', 0.0, 100.0),
    row('uncertainty.thickness', 0.1e-3, 'Largest error of thickness, likewise', 'm', 0.0, 0.05),
    row('uncertainty.mass', 0.01, 'Largest relative error of the mass, likewise', '', 0.0, 0.9),
    row('uncertainty.frequency', 0.1, 'Largest error of the frequency, also of a measured plate',
        'Hz', 0.0, 500.0),
    row('uncertainty.damping_ratio', 0.003, 'Largest error of the damping ratio, likewise',
        '', 0.0, 0.5),
    row('recommendation.objective', 'peak',
        'Goal: the most energy per throw, the most in the worst case of the uncertainties, the '
        'most in the worst of several throws, or the smallest amplitude that reaches a target',
        choices=('peak', 'robust', 'versatile', 'aim')),
    row('recommendation.vary', 'both',
        'Properties that may change, except when aiming: thickness or wave speed of the layer, '
        'both, the layer for one of the library, or the motion of the plate',
        choices=('thickness', 'wave_speed', 'both', 'library', 'motion')),
    row('recommendation.plate_speed', 0.0, 'Largest speed of a designed motion; 0: as it is now',
        'm/s', 1e-3, 100.0, or_zero=True),
    row('recommendation.plate_acceleration', 0.0, 'Its largest acceleration, likewise',
        'm/s2', 0.1, 1e6, or_zero=True),
    row('recommendation.plate_travel', 0.0, 'Largest distance between its extremes, likewise',
        'm', 1e-5, 1.0, or_zero=True),
    row('recommendation.thickness_min', 1e-3, 'Thinnest layer', *BOUNDS['thickness']),
    row('recommendation.thickness_max', 50e-3, 'Thickest layer', *BOUNDS['thickness']),
    row('recommendation.wave_speed_min', 1.0, 'Slowest wave', *BOUNDS['wave_speed']),
    row('recommendation.wave_speed_max', 50.0, 'Fastest wave', *BOUNDS['wave_speed']),
    row('recommendation.max_strain', 0.0, 'Largest strain; 0 does not limit it',
        '', 1e-3, 10.0, or_zero=True),
    row('recommendation.max_acceleration', 0.0, 'Largest acceleration of the projectile, likewise',
        'm/s2', 1.0, 1e6, or_zero=True),
    row('recommendation.masses', (1.2e-3, 2.4e-3), 'Projectiles of a versatile layer',
        'kg', 1e-5, 1.0, max_length=16),
    row('recommendation.frequencies', (31.1, 63.2), 'Frequencies of a versatile layer',
        'Hz', 1.0, 1000.0, max_length=16),
    row('recommendation.target_height', 0.1, 'Rise of the projectile to aim at; 0 aims at a speed',
        'm', 1e-4, 1000.0, or_zero=True),
    row('recommendation.target_speed', 0.0, 'Speed of the last release; 0 aims at a height',
        'm/s', 1e-3, 200.0, or_zero=True),
    row('recommended.layer', '', 'Layer to pick from the library'),
    row('recommended.thickness', math.nan, 'Best thickness', unit='m'),
    row('recommended.wave_speed', math.nan, 'Best wave speed', unit='m/s'),
    row('recommended.density', math.nan, 'Density of the best layer', unit='kg/m3'),
    row('recommended.loss_tangent', math.nan, 'Loss tangent of the best layer'),
    row('recommended.energy_transfer', math.nan, 'Energy transfer factor of this throw'),
    row('recommended.ejection_speed', math.nan, 'Ejection speed of this throw', unit='m/s'),
    row('recommended.amplitude', math.nan, 'Amplitude that reaches the target', unit='m'),
    row('recommended.peak_strain', math.nan, 'Largest strain of the layer in this throw'),
)


def imply(settings: Settings, name: str, value: Any) -> Settings:
    """
    Return the changes that the change of one value implies, see `Table.imply`.

    A named layer and a stack have values of their own; another value of the layer makes it
    `custom`, and ends a stack. A file of a motion moves the plate; damping ends a harmonic one.
    """
    after = {**settings, name: value}
    if name == 'layer.name' and value != CUSTOM:
        known = library(settings['layer.library']).layers
        if value not in known:
            rule = f'must be one of {", ".join(known)} or {CUSTOM!r}'
            raise ParameterError(f'{name} {rule}, got {quote(value)}', name)
        return known[value]
    if name == 'layer.stack' and value:
        sheets = layers.read_stack(value, lambda: library(after['layer.library']).materials)
        stack = Layer.of_sheets(sheets)
        numbers = {f'layer.{key}': getattr(stack, key) for key in STACKED}
        numbers['layer.stack'] = layers.write_stack(sheets)
        return {**numbers, **_custom_layer({**after, **numbers})}
    if name == motions.PARAMETER:
        if value:
            motions.read(value)
            return {'engine.motion': 'file'}
        return {'engine.motion': 'underdamped'} if settings['engine.motion'] == 'file' else {}
    if name == 'engine.motion' and value == 'file':
        _engine(after, motions.read)
    if name == 'layer.library' and value:
        library(value)  # refuses one that cannot be read
    if name in _TARGETS and value:
        return {target: 0.0 for target in _TARGETS if target != name}
    if value == settings[name]:
        return {}
    if name == 'engine.damping_ratio' and value and settings.get('engine.motion') == 'harmonic':
        return {'engine.motion': 'underdamped'}
    if name in _NAMED:
        ended = {'layer.stack': ''} if name in _STACKED and settings['layer.stack'] else {}
        return {**ended, **_custom_layer({**after, **ended})}
    return {}


def _custom_layer(settings: Settings) -> Settings:
    """Imply that a layer is `custom` if a value is not that of the layer in the library."""
    name = settings.get('layer.name', CUSTOM)
    try:
        values = {} if name == CUSTOM else library(settings['layer.library']).layers[name]
    except (KeyError, ParameterError):  # the library has changed, or cannot be read any more
        return {'layer.name': CUSTOM}
    is_same = all(settings[key] == value for key, value in values.items())
    return {} if is_same else {'layer.name': CUSTOM}


TWIN = Table(node='twin', entries=_ENTRIES, imply=imply)
"""The parameters of the twin."""

RIG_PARAMETERS = tuple(entry.name for entry in TWIN.entries if entry.is_of_rig)
"""Parameters that describe a rig, and require a new one when they change."""


def joint_names(settings: Settings) -> tuple[str, str]:
    """Return the names of plate and projectile; raise ParameterError if they are the same."""
    plate, projectile = (settings[entry.name] for entry in JOINT_ROWS)
    if plate == projectile:
        name = 'joint_names.projectile'
        rule = f'must differ from joint_names.plate, got {quote(plate)}'
        raise ParameterError(f'{name} {rule}', name)
    return plate, projectile


def rig_of(settings: Settings, motion_of: motions.MotionSource = motions.read) -> Rig:
    """
    Make the rig that complete settings describe; ParameterError if a file cannot be read.

    `motion_of` returns the motion of the plate by the path of its file.
    """
    return Rig(
        engine=_engine(settings, motion_of),
        layer=_layer(settings),
        projectile=Projectile(**_values_of(Projectile, settings)),
        gravity=settings['gravity'],
    )


def _engine(settings: Settings, motion_of: motions.MotionSource) -> Engine:
    """Make the engine; a measured plate is expected to follow the file, if there is one."""
    engine = Engine(**_values_of(Engine, settings))
    kind, path = settings['engine.motion'], settings.get(motions.PARAMETER)
    if kind == 'harmonic':
        return replace(engine, damping_ratio=0.0)
    if kind == 'file' and not path:
        rule = f"needs {motions.PARAMETER}, got ''"
        raise ParameterError(f"engine.motion 'file' {rule}", motions.PARAMETER)
    return replace(engine, motion=motion_of(path)) if path and kind != 'underdamped' else engine


def _layer(settings: Settings) -> Layer:
    """Make the layer, of one material or of sheets."""
    layer = Layer(**_values_of(Layer, settings))
    if not settings['layer.stack']:
        return layer
    # journals of 0.2 may name installed materials
    sheets = layers.read_stack(str(settings['layer.stack']), lambda: _INSTALLED.materials)
    shared = {name: getattr(layer, name) for name in ('diameter', 'stress_strain_law', 'loss')}
    return replace(Layer.of_sheets(sheets), **shared)


def rig_values(rig: Rig) -> dict[str, Scalar]:
    """
    Return the values of a rig, including the description of its layer, by parameter name.

    Examples
    --------
    >>> values = rig_values(Rig(layer=Layer.of_sheets((Layer(), Layer(thickness=0.01)))))
    >>> values['layer.stack']
    '0.0168 7.8 1000.0 0.0, 0.01 7.8 1000.0 0.0'

    """
    values = {
        f'{group}.{name}': value
        for group in ('engine', 'layer', 'projectile')
        for name, value in vars(getattr(rig, group)).items() if name not in ('motion', 'parts')
    }
    stack = layers.write_stack(rig.layer.parts)
    return {**values, 'layer.stack': stack, 'gravity': rig.gravity}


def _values_of(kind: type, settings: Settings) -> dict[str, Any]:
    """Return the arguments of a part of the rig, but for a motion of the plate and sheets."""
    group = kind.__name__.lower()
    return {
        item.name: settings[f'{group}.{item.name}'] for item in fields(kind)
        if item.name not in ('motion', 'parts')
    }
