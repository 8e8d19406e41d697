# SPDX-License-Identifier: Apache-2.0
"""Old name of `soft_throw_ros.commands.options.slow_notice`."""

from soft_throw_ros.commands.options import slow_notice as patience

__all__ = ['patience']
