# Copyright 2026 soft_throw_ros developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.
"""The parameters of the twin, and the rig that they describe."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import fields, replace
import difflib
import math
from typing import Any

from soft_throw_ros.configuration import motions
from soft_throw_ros.configuration.layers import BOUNDS, CUSTOM, library, STACKED, whole
from soft_throw_ros.configuration.table import ParameterError, row, Scalar, Settings, Table, Value
from soft_throw_ros.core.models import ELASTICITIES, LOSSES, MODELS
from soft_throw_ros.core.rig import Engine, Layer, Projectile, Rig, Stack

LAYERS: Mapping[str, Mapping[str, float | str]] = library().layers
"""The layers of the installed library: what choosing `layer.name` sets."""

_RIG = Rig()


def _bounds(name: str) -> dict[str, Any]:
    unit, low, high = BOUNDS[name]
    return {'unit': unit, 'low': low, 'high': high}


_ENTRIES = (
    row('engine.motion', 'underdamped',
        'How the plate moves: a damped step (D2), A (1 - cos wt) without damping (Eq. 1), as '
        '`engine.motion_file` tells, or as `~/measured_joint_states` does',
        choices=('underdamped', 'harmonic', 'file', 'measured')),
    row('engine.motion_file', '',
        'File of a motion of the plate, CSV of time and height or a bag; frequency and amplitude '
        'are then units, and the loss tangent is that at the frequency',
        kind='the path of a file, or empty'),
    row('engine.frequency', _RIG.engine.frequency, 'Natural frequency f of the plate',
        unit='Hz', low=1.0, high=1000.0),
    row('engine.amplitude', _RIG.engine.amplitude, 'Height A at which the plate settles',
        unit='m', low=1e-5, high=0.1),
    row('engine.damping_ratio', _RIG.engine.damping_ratio,
        'Damping ratio of the plate, 0 when the motion is harmonic', low=0.0, high=0.99),
    row('measured.window', 2e-3,
        'Time over which a measured plate is smoothed; it is known a quarter of that later',
        unit='s', low=1e-4, high=0.1),
    row('measured.wait', 0.0, 'Time to wait for samples that come after later ones',
        unit='s', low=0.0, high=0.1),
    row('measured.position_noise', 5e-6, 'Standard deviation of measured positions of the plate',
        unit='m', low=1e-9, high=1e-2),
    row('measured.velocity_noise', 1e-2, 'Standard deviation of its measured velocities, if any',
        unit='m/s', low=1e-6, high=10.0),
    row('measured.start', 0.1,
        "Part of the plate's peak speed by `engine.*` at which a throw has started",
        low=0.01, high=0.9),
    row('measured.band', 1e-4,
        'Rms difference of a measured projectile beyond which the model is reported as wrong',
        unit='m', low=1e-7, high=1.0),
    row('measured.prediction_error', 0.01,
        'Half of the 95 % interval of the ejection speed, as a part of it, below which a throw '
        'is first predicted', low=1e-4, high=1.0),
    row('measured.clock_limit', 1.0,
        "How far the clock that stamps the samples may be off the twin's to be corrected; "
        'stamps since boot always are', unit='s', low=0.0, high=1e6),
    row('layer.library', '',
        'File of materials besides those of `config/layers.yaml`, which says how it is written',
        kind='the path of a file, or empty'),
    row('layer.name', 'gelatin_16.8mm',
        'A layer of the library, which sets what it is known by; `custom` after any other change',
        kind='a name in the library, or `custom`', examples=tuple(LAYERS)),
    row('layer.stack', '',
        'Sheets of which the layer is, from the plate up, separated by commas: each is '
        'thickness, wave speed, density and perhaps loss tangent, or thickness and material; '
        'those values of the layer are of the whole, then',
        kind='sheets, as in `8e-3 gelatin, 2e-3 20 1100`, or empty'),
    row('layer.thickness', _RIG.layer.thickness, 'Thickness L_s of the layer',
        **_bounds('thickness')),
    row('layer.wave_speed', _RIG.layer.wave_speed,
        'Wave speed c_s; the modulus is density times its square', **_bounds('wave_speed')),
    row('layer.density', _RIG.layer.density, 'Density rho_s of the layer',
        **_bounds('density')),
    row('layer.diameter', _RIG.layer.diameter, 'Diameter of the layer', **_bounds('diameter')),
    row('layer.loss_tangent', _RIG.layer.loss_tangent,
        "Internal loss of the layer, as its loss tangent at the plate's frequency",
        **_bounds('loss_tangent')),
    row('layer.elasticity', _RIG.layer.elasticity,
        'How the stress of the layer follows strain: in proportion, or as in a neo-Hookean rod, '
        'which stiffens where it is compressed', choices=ELASTICITIES),
    row('layer.loss', _RIG.layer.loss,
        'Whether the loss tangent grows with frequency (Kelvin and Voigt), or is the same over '
        'decades, as that of gels and silicones is', choices=LOSSES),
    row('projectile.mass', _RIG.projectile.mass, 'Mass m of the projectile',
        unit='kg', low=1e-5, high=1.0),
    row('projectile.length', _RIG.projectile.length,
        'Length L_r of the projectile, for the model `finite_difference_elastic`',
        unit='m', low=1e-4, high=0.5),
    row('projectile.youngs_modulus', _RIG.projectile.youngs_modulus,
        'Modulus E_r of the projectile, for the model `finite_difference_elastic`',
        unit='Pa', low=1e6, high=1e12),
    row('gravity', _RIG.gravity, 'Gravity, towards the plate', unit='m/s2', low=0.0, high=30.0),
    row('model', 'travelling_wave',
        'What layer and projectile are taken for; where there is internal loss, large strain '
        'or a stack, the travelling wave gives way to finite differences', choices=MODELS),
    row('throw.period', 1.0, 'Time from one throw to the next; 0 throws only when asked',
        unit='s', low=0.05, high=3600.0, or_zero=True),
    row('throw.max_events', 20,
        'Contacts after which a throw is over; a lossless bounce has no end',
        low=1, high=1000),
    row('rate.state', 1000.0, 'Rate of `~/joint_states`', unit='Hz', low=10.0, high=5000.0),
    row('rate.field', 50.0, 'Rate of `~/layer/joint_states`, at most rate.state',
        unit='Hz', low=0.1, high=1000.0),
    row('time_scale', 1.0, 'Time of the rig over time of the clock; 0.01 is slow motion',
        low=1e-4, high=10.0),
    row('max_strain', 0.1, 'Strain beyond which the layer is reported as no longer linear',
        low=1e-3, high=1.0),
    row('uncertainty.wave_speed', 0.3, 'How far the wave speed may be off, up or down',
        unit='m/s', low=0.0, high=100.0),
    row('uncertainty.thickness', 0.1e-3, 'How far the thickness may be off',
        unit='m', low=0.0, high=0.05),
    row('uncertainty.mass', 0.01, 'How far the mass may be off, as a part of it',
        low=0.0, high=0.9),
    row('uncertainty.frequency', 0.1, 'How far the frequency may be off',
        unit='Hz', low=0.0, high=500.0),
    row('uncertainty.damping_ratio', 0.003, 'How far the damping ratio may be off',
        low=0.0, high=0.5),
    row('recommendation.objective', 'peak',
        'What to look for: `peak`, the most energy per throw; `robust`, the most in the worst '
        'case of the uncertainties; `versatile`, the most in the worst of several throws; `aim`, '
        'the smallest amplitude that reaches a target',
        choices=('peak', 'robust', 'versatile', 'aim')),
    row('recommendation.vary', 'both',
        'What of the layer may be changed: thickness, wave speed, both, or all of it by a pick '
        'from the library; or how the plate moves instead, for the most energy per throw; '
        '`amplitude` is for aiming alone, which always changes it',
        choices=('thickness', 'wave_speed', 'both', 'library', 'motion', 'amplitude')),
    row('recommendation.plate_speed', 0.0,
        'Largest speed of a plate whose motion is designed; 0 is that of its motion now',
        unit='m/s', low=1e-3, high=100.0, or_zero=True),
    row('recommendation.plate_acceleration', 0.0, 'Its largest acceleration, likewise',
        unit='m/s2', low=0.1, high=1e6, or_zero=True),
    row('recommendation.plate_jerk', 0.0, 'Its largest jerk; 0 does not limit it',
        unit='m/s3', low=1.0, high=1e10, or_zero=True),
    row('recommendation.plate_travel', 0.0,
        'How far it may go, from the lowest to the highest position; 0 is as far as now',
        unit='m', low=1e-5, high=1.0, or_zero=True),
    row('recommendation.thickness_min', 1e-3, 'Thinnest layer to consider',
        **_bounds('thickness')),
    row('recommendation.thickness_max', 50e-3, 'Thickest layer to consider',
        **_bounds('thickness')),
    row('recommendation.wave_speed_min', 1.0, 'Slowest wave to consider',
        **_bounds('wave_speed')),
    row('recommendation.wave_speed_max', 50.0, 'Fastest wave to consider',
        **_bounds('wave_speed')),
    row('recommendation.max_strain', 0.0, 'Largest strain to allow; 0 does not limit it',
        low=1e-3, high=10.0, or_zero=True),
    row('recommendation.max_acceleration', 0.0,
        'Largest acceleration of the projectile to allow; 0 does not limit it',
        unit='m/s2', low=1.0, high=1e6, or_zero=True),
    row('recommendation.max_loss_tangent', 0.0,
        'Largest loss tangent of a material to pick; 0 does not limit it',
        low=1e-3, high=2.0, or_zero=True),
    row('recommendation.max_amplitude', 0.1, 'Largest amplitude to aim with',
        unit='m', low=1e-5, high=0.1),
    row('recommendation.quantile', 0.0,
        'Which case counts when robust: 0 is the worst, 0.05 is worse than 95 % of all',
        low=0.0, high=0.5),
    row('recommendation.masses', (1.2e-3, 2.4e-3), 'Projectiles of a versatile layer',
        unit='kg', low=1e-5, high=1.0, max_length=16),
    row('recommendation.frequencies', (31.1, 63.2), 'Frequencies of a versatile layer',
        unit='Hz', low=1.0, high=1000.0, max_length=16),
    row('recommendation.target_height', 0.1,
        'How far the projectile is to rise when aiming; 0 aims at a speed',
        unit='m', low=1e-4, high=1000.0, or_zero=True),
    row('recommendation.target_speed', 0.0,
        'How fast the projectile is to leave when aiming; 0 aims at a height',
        unit='m/s', low=1e-3, high=200.0, or_zero=True),
    row('recommended.layer', '', 'Layer to pick from the library'),
    row('recommended.thickness', math.nan, 'Best thickness', unit='m'),
    row('recommended.wave_speed', math.nan, 'Best wave speed', unit='m/s'),
    row('recommended.density', math.nan, 'Density of the best layer', unit='kg/m3'),
    row('recommended.youngs_modulus', math.nan, 'Modulus of the best layer', unit='Pa'),
    row('recommended.loss_tangent', math.nan, 'Loss tangent of the best layer'),
    row('recommended.amplitude', math.nan, 'Amplitude that reaches the target', unit='m'),
    row('recommended.mass_ratio', math.nan, 'Projectile over layer mass, mu, of the best layer'),
    row('recommended.speed_ratio', math.nan, 'c_s / (L_s f), kappa, of the best layer'),
    row('recommended.energy_transfer', math.nan, 'Energy transfer factor alpha it gives'),
    row('recommended.score', math.nan, 'Energy transfer factor that counts for the objective'),
    row('recommended.ejection_time', math.nan, 'Ejection time t_e it gives', unit='s'),
    row('recommended.ejection_speed', math.nan, 'Ejection speed V_e it gives', unit='m/s'),
    row('recommended.peak_strain', math.nan,
        'Largest strain of the layer up to the first release'),
    row('recommended.peak_acceleration', math.nan,
        'Largest acceleration of the projectile up to the first release', unit='m/s2'),
    row('recommended.peak_force', math.nan,
        'Largest force on the plate up to the first release', unit='N'),
    row('recommended.plate_work', math.nan, 'Work of the plate up to the first release', unit='J'),
)


def imply(settings: Settings, changes: Settings) -> dict[str, Value]:
    """
    Add to `changes` what they imply.

    A layer's name implies the layer's values, and a value that is not the named layer's makes it
    `custom`. A stack implies the values of the whole, and another value that there is no stack.
    Harmonic motion implies no damping, and damping that the motion is underdamped. A file implies
    that the plate moves by it, and none that it does not. Aiming at a speed implies that no height
    is aimed at, and the other way round. What was asked for is never replaced.

    Raises
    ------
    ParameterError
        If the library has no layer of that name, or a file or a stack cannot be read.

    """
    implied: dict[str, Value] = {}
    layers = _layers({**settings, **changes})
    name = changes.get('layer.name')
    if name is not None and name not in (CUSTOM, *layers):
        close = difflib.get_close_matches(str(name), layers, n=1)
        advice = f'did you mean {close[0]}?' if close else f'there are {", ".join(layers)}'
        raise ParameterError(
            f'layer.name must be a name in the library, or {CUSTOM!r}, got {name!r}; {advice}',
            'layer.name',
        )
    if name is not None:
        implied.update(layers.get(str(name), {}))
    elif settings['layer.name'] != CUSTOM and (
        settings['layer.name'] not in layers or _departures(layers, settings, changes)
    ):
        implied['layer.name'] = CUSTOM
    stack = changes.get('layer.stack')
    if stack:
        implied.update(_whole({**settings, **changes}))
    elif stack is None and settings['layer.stack'] and any(name in changes for name in STACKED):
        implied.setdefault('layer.stack', '')
    motions.of_settings({**settings, 'engine.motion': '', **changes})
    if changes.get(motions.PARAMETER):
        motions.read(str(changes[motions.PARAMETER]))
        implied['engine.motion'] = 'file'
    elif motions.PARAMETER in changes and settings['engine.motion'] == 'file':
        implied['engine.motion'] = 'underdamped'
    motion = changes.get('engine.motion', implied.get('engine.motion'))
    if motion == 'harmonic':
        implied['engine.damping_ratio'] = 0.0
    elif settings['engine.motion'] == 'harmonic':
        if motion == 'underdamped':
            implied['engine.damping_ratio'] = _RIG.engine.damping_ratio
        elif changes.get('engine.damping_ratio'):
            implied['engine.motion'] = 'underdamped'
    for target, other in (_TARGETS, _TARGETS[::-1]):
        if changes.get(target):
            implied[other] = 0.0
    return {**changes, **{name: implied[name] for name in implied if name not in changes}}


def contradictions(settings: Settings) -> Iterator[ParameterError]:
    """
    Find values of complete settings that contradict each other.

    Any of them may come about by single changes, which are all accepted; refused is what is asked
    for at once.
    """
    layers, layer = _layers(settings), settings['layer.name']
    for name in _departures(layers, settings, settings):
        yield ParameterError(
            f'{name} of {layer} is {_shown(layers[layer][name])}, got {_shown(settings[name])}; '
            f'leave one of the two out, or set layer.name to {CUSTOM!r}',
            name,
            'layer.name',
        )
    if settings['layer.stack']:
        try:
            values = _whole(settings)
        except ParameterError as error:  # the library has changed
            values = {}
            yield error
        for name, value in values.items():
            if settings[name] != value:
                yield ParameterError(
                    f'{name} of the stack is {value:g}, got {settings[name]:g}; '
                    'leave one of the two out',
                    name,
                    'layer.stack',
                )
    height, speed = (settings[name] for name in _TARGETS)
    if height and speed:
        yield ParameterError(
            f'one of {" and ".join(_TARGETS)} must be 0, got {height:g} and {speed:g}', *_TARGETS
        )
    damping = settings['engine.damping_ratio']
    if settings['engine.motion'] == 'harmonic' and damping > 0.0:
        yield ParameterError(
            f"engine.motion 'harmonic' has no damping, got engine.damping_ratio {damping:g}; "
            "leave one of the two out, or set engine.motion to 'underdamped'",
            'engine.damping_ratio',
            'engine.motion',
        )
    for low, high, bound in (
        ('recommendation.thickness_min', 'recommendation.thickness_max', 'below'),
        ('recommendation.wave_speed_min', 'recommendation.wave_speed_max', 'below'),
        ('rate.field', 'rate.state', 'at most'),
    ):
        smaller, larger = settings[low], settings[high]
        if smaller > larger or (smaller == larger and bound == 'below'):
            yield ParameterError(
                f'{low} must be {bound} {high}, got {smaller:g} and {larger:g}', low, high
            )


TWIN = Table(
    node='twin',
    entries=_ENTRIES,
    hints={
        'layer.youngs_modulus': 'the modulus is density times wave speed squared: '
        'set layer.wave_speed'
    },
    imply=imply,
    contradictions=contradictions,
)
"""The parameters of the twin."""


def rig_of(settings: Settings) -> Rig:
    """
    Make the rig that the settings describe; ParameterError if a file cannot be read.

    Examples
    --------
    >>> rig_of(TWIN.defaults()) == Rig()
    True

    """
    if settings['engine.motion'] == 'harmonic':
        settings = {**settings, 'engine.damping_ratio': 0.0}

    def values(part: type) -> dict[str, Any]:
        group = part.__name__.lower()
        names = (item.name for item in fields(part) if item.name != 'motion')
        return {name: settings[f'{group}.{name}'] for name in names}

    layer = Layer(**values(Layer))
    if settings['layer.stack']:
        shared = {name: getattr(layer, name) for name in ('diameter', 'elasticity', 'loss')}
        sheets = library(settings['layer.library']).sheets(settings['layer.stack'])
        layer = Stack(sheets=tuple(replace(sheet, **shared) for sheet in sheets))
    return Rig(
        engine=Engine(**values(Engine), motion=motions.of_settings(settings)),
        layer=layer,
        projectile=Projectile(**values(Projectile)),
        gravity=settings['gravity'],
    )


def rig_values(rig: Rig) -> dict[str, Scalar]:
    """
    Return the numbers of a rig, and what its layer is, by the names of their parameters.

    Examples
    --------
    >>> values = rig_values(Rig(layer=Stack(sheets=(Layer(), Layer(thickness=0.01)))))
    >>> values['layer.stack']
    '0.0168 7.8 1000.0 0.0, 0.01 7.8 1000.0 0.0'

    """
    stack = ''
    if isinstance(rig.layer, Stack):
        stack = ', '.join(
            ' '.join(str(getattr(sheet, name.removeprefix('layer.'))) for name in STACKED)
            for sheet in rig.layer.sheets
        )
    return {
        **{
            f'engine.{item.name}': getattr(rig.engine, item.name)
            for item in fields(Engine)
            if item.name != 'motion'
        },
        **{f'layer.{item.name}': getattr(rig.layer, item.name) for item in fields(Layer)},
        'layer.stack': stack,
        **{
            f'projectile.{item.name}': getattr(rig.projectile, item.name)
            for item in fields(Projectile)
        },
        'gravity': rig.gravity,
    }


_TARGETS = ('recommendation.target_height', 'recommendation.target_speed')


def _whole(settings: Settings) -> dict[str, float]:
    """Return what the stack of the settings has as a whole."""
    return whole(library(str(settings['layer.library'])).sheets(str(settings['layer.stack'])))


def _shown(value: Value) -> str:
    return f'{value:g}' if isinstance(value, float) else repr(value)


def _layers(settings: Settings) -> Mapping[str, Mapping[str, float | str]]:
    """Return the layers of the library, that of the settings included."""
    return library(str(settings['layer.library'])).layers


def _departures(
    layers: Mapping[str, Mapping[str, float | str]], settings: Settings, values: Settings
) -> list[str]:
    """Name the values that are not those of the named layer."""
    known = layers.get(settings['layer.name'], {})
    return [name for name, value in known.items() if values.get(name, value) != value]
