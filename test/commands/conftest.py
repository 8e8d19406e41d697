# SPDX-License-Identifier: Apache-2.0
"""Tasks of the command `design`, run as from a shell."""

import json
import re

import pytest
from soft_throw_ros.commands import design


class Task:
    """A task of the command `design`."""

    def __init__(self, name, capsys):
        self._name = name
        self._capsys = capsys

    def run(self, *args, code=0):
        """Run it; return what it printed."""
        assert design.main([self._name, *map(str, args)]) == code
        return self._capsys.readouterr().out

    def run_json(self, *args, code=0):
        """Run it with `--json`; return the object that it printed."""
        return json.loads(self.run('--json', *args, code=code))

    def refused(self, *args):
        """Run it with something that it refuses; return what it says."""
        with pytest.raises(SystemExit) as end:
            design.main([self._name, *map(str, args)])
        assert end.value.code == 2
        out, err = self._capsys.readouterr()
        assert out == ''
        usage, message = err.splitlines()[-2:]  # it may have said before that it compiles
        assert usage.startswith('usage: ')
        return message.partition('error: ')[2]

    @staticmethod
    def row(printed, title):
        """Return the cells of a row of a table."""
        (line,) = re.findall(rf'^{re.escape(title)}\s.*', printed, re.MULTILINE)
        return line[28:].split()


@pytest.fixture
def task(request, capsys):
    """Offer the task that the module names as `TASK`."""
    return Task(request.module.TASK, capsys)
