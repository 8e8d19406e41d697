# SPDX-License-Identifier: Apache-2.0
"""YAML as it stands in bags, which may be anybody's."""

from __future__ import annotations

from typing import Any

import yaml

LONGEST = 2**20
"""What would take longer to read than anybody waits is refused. [characters]"""

_Dumper = getattr(yaml, 'CSafeDumper', yaml.SafeDumper)  # the same, and faster where it is there


def dump(data: Any) -> str:
    """Write YAML."""
    text: str = yaml.dump(data, Dumper=_Dumper, sort_keys=False)
    return text


def load(text: str) -> Any:
    """
    Read YAML of whatever origin.

    Raises
    ------
    ValueError
        If it is none, or too long.

    Notes
    -----
    LibYAML would be faster, but many an opening bracket makes it overflow its stack.

    """
    if len(text) > LONGEST:
        raise ValueError(f'YAML of {len(text)} characters, more than {LONGEST}')
    try:
        return yaml.safe_load(text)
    # PyYAML raises what comes its way if, say, a text is tagged as a number
    except (yaml.YAMLError, ValueError, LookupError, TypeError, RecursionError) as error:
        raise ValueError(str(error).partition('\n')[0]) from None
