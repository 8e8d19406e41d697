# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Fixtures that run commands as from a shell."""

import json
import re

import pytest


class Command:
    """A command named by `COMMAND` of the test module: its main function and leading words."""

    def __init__(self, main, *words, capsys):
        self._main = main
        self._words = words
        self._capsys = capsys
        self.err = ''

    def run(self, *args, code=0):
        """Run the command, check its exit code, return its output and keep its standard error."""
        assert self._main([*self._words, *map(str, args)]) == code
        out, self.err = self._capsys.readouterr()
        return out

    def json(self, *args, code=0):
        """Run the command with `--json` and return the decoded object."""
        return json.loads(self.run(*args, '--json', code=code))

    def refused(self, *args):
        """Run the command with arguments that it refuses and return the error message."""
        with pytest.raises(SystemExit) as end:
            self._main([*self._words, *map(str, args)])
        assert end.value.code == 2
        out, err = self._capsys.readouterr()
        assert out == ''
        assert 'Traceback' not in err
        assert 'usage: ' not in err
        (line,) = [line for line in err.splitlines() if ': error: ' in line]
        return line.partition('error: ')[2]

    @staticmethod
    def row(printed, title):
        """Return the cells of a row of a table."""
        (line,) = re.findall(rf'^{re.escape(title)}\s\s.*', printed, re.MULTILINE)
        return line[28:].split()


@pytest.fixture
def command(request, capsys):
    """Return the command named by `COMMAND` of the test module."""
    return Command(*request.module.COMMAND, capsys=capsys)
