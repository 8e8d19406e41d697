# SPDX-License-Identifier: Apache-2.0
"""What the README says is so."""

from pathlib import Path
import re

import pytest
from soft_throw_ros.commands import design
from soft_throw_ros.configuration.layers import library

README = Path(__file__).parents[1] / 'README.md'
TEXT = README.read_text(encoding='utf-8')


def test_python_example_prints_an_ejection_time(capsys):
    (example,) = re.findall(r'```python\n(.*?)```', TEXT, flags=re.DOTALL)
    exec(compile(example, str(README), 'exec'), {})
    assert re.fullmatch(r'leaves after 7\.6\d\d ms, alpha 3\.6\d\d\n', capsys.readouterr().out)


def test_example_of_a_library_is_one(tmp_path):
    (example,) = re.findall(r'```yaml\n(.*?)```', TEXT, flags=re.DOTALL)
    path = tmp_path / 'mine.yaml'
    path.write_text(example, encoding='utf-8')
    assert {'my_silicone_10.0mm', 'my_silicone_20.0mm'} < library(path).layers.keys()


@pytest.mark.parametrize(
    ('args', 'code'),
    [
        (['recommend', '--vary', 'thickness', '--objective', 'robust'], 0),
        (['aim', '--target-speed', '2.5', '--vary', 'amplitude', '--max-strain', '0.1'], 1),
    ],
)
def test_answers_of_design_are_what_is_printed(capsys, args, code):
    assert design.main(args) == code
    answer = capsys.readouterr().out.partition('; a layer of')[0].partition('\n')[0]
    assert answer in ' '.join(TEXT.split())


@pytest.mark.parametrize('path', re.findall(r'\]\(([^)#]+)\)', TEXT))
def test_what_is_linked_is_there(path):
    assert (README.parent / path).is_file()
