# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Settings of all tests; those of nodes need ROS."""

from collections.abc import Callable, Iterator
import gc
from importlib.util import find_spec
import json
from pathlib import Path
import re
import signal

import hypothesis
from hypothesis.internal.conjecture import providers
import numpy as np
import pytest

gc.disable()  # while modules are imported
pytest_plugins = ['ros_nodes'] if find_spec('rclpy') else []

# Hypothesis draws constants from the local modules that happen to be imported. Examples would then
# depend on earlier tests and on threads that import. There is no public switch for this.
providers.is_local_module_file = lambda _path: False
# The same examples in every run; no deadline, because the machine may be busy.
hypothesis.settings.register_profile(
    'repeatable',
    deadline=None,
    derandomize=True,
    phases=set(hypothesis.Phase) - {hypothesis.Phase.explain},  # takes minutes with a session
    suppress_health_check=[hypothesis.HealthCheck.too_slow],
)
hypothesis.settings.load_profile('repeatable')

# Child processes receive these signals even if the tests run under nohup.
for number in (signal.SIGINT, signal.SIGHUP):
    if signal.getsignal(number) == signal.SIG_IGN:
        signal.signal(number, lambda *_: None)


@pytest.hookimpl(wrapper=True)
def pytest_collect_file(file_path: Path, parent: pytest.Collector) -> Iterator[None]:
    """Keep tests from the collector of doctests, which skips a file that it cannot import."""
    collectors = yield
    return [item for item in collectors if type(item).__name__ != 'DoctestModule']


def pytest_collection_finish() -> None:
    """Leave all imported modules out of later garbage collections, of which some are requested."""
    gc.enable()
    gc.freeze()


@pytest.fixture(autouse=True)
def floating_point_errors_raise() -> Iterator[None]:
    """Raise on floating-point errors except underflow, which decaying values cause."""
    with np.errstate(divide='raise', over='raise', invalid='raise'):
        yield


@pytest.fixture(scope='session')
def result_keys() -> set[str]:
    """Return the keys of a result that docs/results.md describes."""
    page = (Path(__file__).parents[1] / 'docs/results.md').read_text('utf-8')
    rows = (line.split('|')[1] for line in page.splitlines() if line.startswith('| `'))
    return set(re.findall(r'`([\w.]+)`', ' '.join(rows)))


@pytest.fixture
def write(tmp_path: Path) -> Callable[..., Path]:
    """Return a function that writes a file and returns its path."""

    def write(content: str | bytes, name: str = 'file') -> Path:
        path = tmp_path / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    return write


class Command:
    """A command named by `COMMAND` of the test module: its main function and leading words."""

    def __init__(self, main, *words, capsys):
        self._main, self._words, self._capsys = main, words, capsys
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
        assert (out, 'Traceback' in err, 'usage: ' in err) == ('', False, False)
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
