# SPDX-License-Identifier: Apache-2.0
"""Old name of `soft_throw_ros.commands.options`."""

from soft_throw_ros.commands.options import Row, write_columns

__all__ = ['Row', 'write_columns']
