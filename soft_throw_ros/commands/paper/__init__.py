# SPDX-License-Identifier: Apache-2.0
"""The figures and the numbers of the paper, computed; for the command `figures`."""
