# SPDX-License-Identifier: Apache-2.0
"""Quality of service of a publisher, as rosbag2 writes it into a bag; without ROS."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
import functools
from typing import Any

import yaml

_DUMPER = getattr(yaml, 'CSafeDumper', yaml.SafeDumper)  # faster where it is there

_TIMES = ('deadline', 'lifespan', 'liveliness_lease_duration')

INFINITE = 2**63 - 1
"""A time that is never over. [ns]"""

_SECOND = 1_000_000_000

# In the order of the numbers that rmw gives them, which older bags have instead of names.
_CHOICES = {
    'history': ('system_default', 'keep_last', 'keep_all', 'unknown'),
    'reliability': ('system_default', 'reliable', 'best_effort', 'unknown', 'best_available'),
    'durability': ('system_default', 'transient_local', 'volatile', 'unknown', 'best_available'),
    'liveliness': (
        'system_default',
        'automatic',
        'manual_by_node',
        'manual_by_topic',
        'unknown',
        'best_available',
    ),
}


@dataclass(frozen=True, kw_only=True)
class Qos:
    """
    What a publisher offers.

    Raises
    ------
    ValueError
        Quoting what is none of the choices.

    """

    history: str = 'keep_last'  # What it keeps to send again
    depth: int = 10  # How many messages it keeps
    reliability: str = 'reliable'  # Whether it sends again what was lost
    durability: str = 'volatile'  # Whether late subscribers get what it keeps
    # `INFINITE` by default. [ns]
    deadline: int = INFINITE
    lifespan: int = INFINITE
    liveliness: str = 'automatic'  # How it shows that it is alive
    liveliness_lease_duration: int = INFINITE
    avoid_ros_namespace_conventions: bool = False  # Whether its topic is called the same in DDS

    def __post_init__(self) -> None:
        for name, choices in _CHOICES.items():
            value = getattr(self, name)
            if value not in choices:
                raise ValueError(f'{name} must be one of {", ".join(choices)}, got {value!r}')

    def to_dict(self) -> dict[str, Any]:
        """Return what stands for it in version 9 of `metadata.yaml`."""
        return {
            name: dict(zip(('sec', 'nsec'), divmod(value, _SECOND), strict=True))
            if name in _TIMES
            else value
            for name, value in vars(self).items()
        }


def to_yaml(profiles: Sequence[Qos]) -> str:
    """Write profiles as the text that the channel of an MCAP file has."""
    return dump_yaml([profile.to_dict() for profile in profiles]).strip() if profiles else ''


@functools.lru_cache(maxsize=1000)  # every file of a bag, and many channels, have the same
def from_yaml(text: str | None) -> tuple[Qos, ...]:
    """
    Read `offered_qos_profiles` of a channel, as any version of rosbag2 writes them.

    The policies are names, or numbers before version 9; nothing stands for no profile.

    Raises
    ------
    ValueError
        Quoting what is no profile.

    Examples
    --------
    >>> from_yaml('[{history: 1, depth: 3, reliability: 2}]')[0].reliability
    'best_effort'

    """
    try:
        items = load_yaml(text or '') or []
        if not isinstance(items, list):
            raise ValueError('no list')  # noqa: TRY301
        return tuple(map(_profile, items))
    except (ValueError, TypeError, LookupError, OverflowError, AttributeError) as error:
        raise ValueError(f'no quality of service, {error}: {text!r:.200}') from None


def _profile(item: Mapping[str, Any]) -> Qos:
    if not isinstance(item, Mapping):
        raise ValueError(f'{item!r} is no mapping')
    values = {field.name: item[field.name] for field in fields(Qos) if field.name in item}
    for name, value in values.items():
        if name in _CHOICES:
            values[name] = _choice(_CHOICES[name], value)
        elif name in _TIMES:
            time = int(value['sec']) * _SECOND + int(value['nsec'])
            values[name] = min(time, INFINITE)
        else:
            values[name] = int(value) if name == 'depth' else bool(value)
    return Qos(**values)


def _choice(choices: Sequence[str], value: Any) -> str:
    """Name a policy; one that rosbag2 may have by now, and we do not know, is unknown."""
    if isinstance(value, int):
        return choices[value] if 0 <= value < len(choices) else 'unknown'
    return value if value in choices else 'unknown'


def dump_yaml(data: Any) -> str:
    """Write YAML."""
    text: str = yaml.dump(data, Dumper=_DUMPER, sort_keys=False)
    return text


def load_yaml(text: str) -> Any:
    """
    Read YAML of whatever origin.

    Raises
    ------
    ValueError
        If it is none.

    Notes
    -----
    LibYAML would be faster, but many an opening bracket makes it overflow its stack.

    """
    try:
        return yaml.safe_load(text)
    # PyYAML raises what comes its way if, say, a text is tagged as a number
    except (yaml.YAMLError, ValueError, LookupError, TypeError, RecursionError) as error:
        raise ValueError(str(error).partition('\n')[0]) from None
