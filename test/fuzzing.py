# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Generators of invalid input, and the checks that every case must pass.

A case has a limit of time and memory, writes to its own folder only, and ends with a result
without NaN or with an error of one line.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
import contextlib
import io
import math
import os
from pathlib import Path
import re
import resource
import signal
import struct
import sys
import tempfile
from typing import Any, TypeVar

from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st

CASES = int(os.environ.get('FUZZ_CASES', '2000'))
"""Total number of cases, divided among the tests decorated by `fuzzed`."""

TIME_LIMIT = 60
"""Longest duration of a case on a busy machine. [s]"""

MEMORY_LIMIT = 500_000_000
"""Largest additional memory of a case. [bytes]"""

NUMBERS = [
    'nan', '.nan', 'NaN', 'inf', '-.inf', '-inf', '1e400', '-1e400', '1e308', '5e-324', '-0.0',
    '0', '-1', '1', '1e-3', '0x1F', '1_000', '١', '1,5', '9' * 400, '18446744073709551616',
]
WORDS = [
    *NUMBERS, '', ' ', '\t', '\n', '\r', '\0', '\ufeff', ':', ': ', '- ', '? ', '#', ',', ';',
    '[', ']', '{', '}', '[' * 300, '{a: ' * 300, '&a ', '*a', '<<: *a', '!!float x', '!!null ',
    '!!python/object/apply:os.system [exit 1]', '!!binary x', '---\n', '...\n', '%YAML 9\n', '|\n',
    "'", '"', '\\', '%', '~', 'null', 'true', 'no', '2026-11-22', '1:30', '/', '../', '/tmp/x',
    '*', '**', '${HOME}', 'ä', '\N{PILE OF POO}', '\u2028', 'a' * 3000, ':=', '+-', '--', '=',
]


Result = TypeVar('Result')


class CaseHangs(BaseException):
    """A case exceeds its time; a BaseException, which no handler of bad input catches."""


def fuzzed(share: float, least: int = 2) -> Callable[[Any], Any]:
    """Return a decorator that runs a test with its share of all cases."""
    return settings(
        max_examples=max(least, round(share * CASES)),
        deadline=None,
        phases=(Phase.explicit, Phase.reuse, Phase.generate),  # shrinking takes minutes
        suppress_health_check=list(HealthCheck),
    )


def texts(*valid: str) -> st.SearchStrategy[str]:
    """Return valid texts with parts removed, doubled, moved, or replaced by words and numbers."""

    @st.composite
    def strategy(draw: Callable[..., Any]) -> str:
        text: str = draw(st.sampled_from(valid))
        for _ in range(draw(st.integers(0, 4))):
            text = draw(st.sampled_from(_TEXT_EDITS))(draw, text)
        return text

    return strategy()


def _put_word(draw: Callable[..., Any], text: str) -> str:
    begin, end = _span(draw, len(text), longest=12)
    return text[:begin] + draw(st.sampled_from(WORDS) | st.text(max_size=5)) + text[end:]


def _put_number(draw: Callable[..., Any], text: str) -> str:
    matches = list(re.finditer(r'-?\d[\d.]*(?:e-?\d+)?', text))
    if not matches:
        return text
    match = draw(st.sampled_from(matches))
    number = draw(st.sampled_from(NUMBERS) | st.floats().map(repr) | st.integers().map(str))
    return text[: match.start()] + number + text[match.end():]


def _cut(draw: Callable[..., Any], text: str) -> str:
    begin, end = _span(draw, len(text), longest=len(text))
    return text[:begin] + text[end:]


def _double(draw: Callable[..., Any], text: str) -> str:
    begin, end = _span(draw, len(text), longest=200)
    return text[:end] + text[begin:]


def _move_line(draw: Callable[..., Any], text: str) -> str:
    lines = text.splitlines(keepends=True)
    if not lines:
        return text
    line = lines.pop(draw(st.integers(0, len(lines) - 1)))
    lines.insert(draw(st.integers(0, len(lines))), draw(st.sampled_from(['', '  '])) + line)
    return ''.join(lines)


_TEXT_EDITS = (_put_word, _put_number, _put_number, _cut, _double, _move_line)


def datas(*valid: bytes) -> st.SearchStrategy[bytes]:
    """Return valid data truncated, with flipped bits, changed numbers, or doubled parts."""

    @st.composite
    def strategy(draw: Callable[..., Any]) -> bytes:
        data = bytearray(draw(st.sampled_from(valid)))
        for _ in range(draw(st.integers(1, 4))):
            if not data:
                break
            begin, end = _span(draw, len(data), longest=draw(st.sampled_from([4, 64, 10**9])))
            match draw(st.sampled_from(['flip', 'number', 'cut', 'double', 'end', 'fill'])):
                case 'flip':
                    data[begin % len(data)] ^= 1 << draw(st.integers(0, 7))
                case 'number':
                    kind, number = draw(st.sampled_from(_RAW_NUMBERS))
                    data[begin:begin + struct.calcsize(kind)] = struct.pack(kind, number)
                case 'cut':
                    del data[begin:end]
                case 'double':
                    data[end:end] = data[begin:end]
                case 'end':
                    del data[begin:]
                case 'fill':
                    data[begin:end] = bytes([draw(st.sampled_from([0, 255]))]) * (end - begin)
        return bytes(data)

    return strategy()


_RAW_NUMBERS = [
    *(('<I', number) for number in (0, 1, 2**16, 2**28, 2**31, 2**32 - 1)),
    *(('<Q', number) for number in (0, 2**28, 2**32, 2**62, 2**63, 2**64 - 1)),
    *(('<d', number) for number in (math.nan, math.inf, -math.inf, 1e308, -1e-308)),
]


def _span(draw: Callable[..., Any], size: int, *, longest: int) -> tuple[int, int]:
    begin = draw(st.integers(0, size))
    return begin, draw(st.integers(begin, min(size, begin + longest)))


VALUES: st.SearchStrategy[Any] = st.one_of(
    st.floats(),
    st.integers(),
    st.booleans(),
    st.none(),
    st.sampled_from(WORDS),
    st.sampled_from([10**400, -(2**63), 2**64, math.nan, math.inf, -0.0, b'x', {}, [[]], ()]),
    st.text(max_size=8),
    st.lists(st.floats() | st.integers() | st.text(max_size=3), max_size=4),
    st.lists(st.floats(), min_size=1001, max_size=1003),
)
"""Valid and invalid values of parameters."""


@contextlib.contextmanager
def bounded(*folders: Path) -> Iterator[None]:
    """Limit the time and memory of a case, and let it write below its folders only."""
    _written.clear()
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    pages = int(Path('/proc/self/statm').read_text(encoding='ascii').split()[0])
    limit = pages * resource.getpagesize() + MEMORY_LIMIT
    before = signal.signal(signal.SIGALRM, _fail)
    try:
        resource.setrlimit(resource.RLIMIT_AS, (limit, hard))
        signal.alarm(TIME_LIMIT)
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))
        written = [Path(path).resolve() for path in _written]
        _written.clear()
    elsewhere = [path for path in written if not any(map(path.is_relative_to, folders))]
    assert not elsewhere, f'written outside {folders}: {elsewhere}'


def _fail(_number: int, _frame: object) -> None:
    raise CaseHangs(f'a case takes more than {TIME_LIMIT} s')


_written: list[str] = []
_TEMPORARY = f'{tempfile.gettempdir()}/tmp'  # prefix of the names from Python's tempfile
_WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC


def _on_audit(event: str, arguments: tuple[Any, ...]) -> None:
    """Record the paths of written, created and deleted files."""
    if event == 'open':
        path, _, flags = arguments
        if isinstance(path, (str, bytes)) and flags & _WRITING:
            _note(os.fsdecode(path))
    elif event in {'os.mkdir', 'os.rename', 'os.remove', 'os.rmdir', 'os.symlink', 'os.truncate'}:
        for path in arguments[:2]:
            if isinstance(path, (str, bytes)):
                _note(os.fsdecode(path))


def _note(path: str) -> None:
    is_temporary = path.startswith(_TEMPORARY) or path == os.devnull
    if '__pycache__' not in path and not is_temporary:  # caches of numba and Python
        _written.append(path)


sys.addaudithook(_on_audit)


def accepted(
    function: Callable[[], Result], *words: str, error: type[Exception] = ValueError
) -> Result | None:
    """Return the result of a function, or None if an error of one line with the words refuses."""
    try:
        return function()
    except error as refusal:
        text = str(refusal)
        assert text.strip()
        assert '\n' not in text, text
        assert all(word in text for word in words), text
        return None


def run(main: Callable[[list[str]], int | None], arguments: Sequence[str]) -> tuple[int, str, str]:
    """Run a command, check the promises of all, return exit code, output and error."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            code = main(list(arguments)) or 0
        except SystemExit as end:
            code = int(end.code or 0)
    message = err.getvalue()
    assert code in {0, 1, 2}, message
    assert 'Traceback' not in message
    if code == 2:
        lines = message.splitlines()
        assert lines, 'refused without a message'
        assert all(re.match(r'[\w.-]+( [\w.-]+)?: ', line) for line in lines), message
        assert sum('error: ' in line for line in lines) <= 1, message
        assert not out.getvalue()
    assert not re.search(r'\b(nan|NaN)\b', out.getvalue()), out.getvalue()
    return code, out.getvalue(), message


def run_on(
    path: Path, content: str | bytes, main: Callable[[list[str]], int | None], *arguments: str
) -> tuple[int, str, str]:
    """Write a file and run a command on it, as `run` does, within the limits of a case."""
    path.write_bytes(content if isinstance(content, bytes) else content.encode(errors='replace'))
    with bounded(path.parent):
        return run(main, arguments)
