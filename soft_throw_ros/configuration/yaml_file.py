# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""YAML files with parameters, materials or settings of a fit."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from soft_throw_ros.configuration.table import ParameterError
from soft_throw_ros.storage.regular_file import read_regular_file
import yaml

_MAX_BYTES = 1 << 18  # 30 times the installed files; PyYAML reads them in seconds [byte]


def read_yaml(path: str | Path) -> dict[Any, Any]:
    """Return the mapping in a file, which may be empty."""
    try:
        text = read_regular_file(path, max_bytes=_MAX_BYTES).decode()
        has_alias = any(isinstance(token, yaml.AliasToken) for token in yaml.scan(text))
        root = None if has_alias else yaml.safe_load(text)
    except OSError as error:
        raise ParameterError(f'{path}: {error.strerror}') from None
    except RecursionError:
        raise ParameterError(f'{path}: is nested too deeply') from None
    except (yaml.YAMLError, ValueError, LookupError, AttributeError, TypeError) as error:
        # constructors of PyYAML raise all these
        raise ParameterError(f'{path}: {" ".join(str(error).split())}') from None
    if has_alias:
        raise ParameterError(f'{path}: an alias (*NAME) is not allowed')
    if root is not None and not isinstance(root, dict):
        raise ParameterError(f'{path}: must be a mapping (NAME: VALUE), got {type(root).__name__}')
    return root or {}
