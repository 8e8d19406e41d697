# SPDX-License-Identifier: Apache-2.0
"""What the README says is so."""

from pathlib import Path
import re

import pytest
from soft_throw_ros.configuration import document

README = Path(__file__).parents[1] / 'README.md'
TEXT = README.read_text(encoding='utf-8')


def test_table_of_parameters_is_current():
    assert document.insert_markdown(TEXT) == TEXT


def test_python_example_prints_an_ejection_time(capsys):
    (example,) = re.findall(r'```python\n(.*?)```', TEXT, flags=re.DOTALL)
    exec(compile(example, str(README), 'exec'), {})
    assert re.fullmatch(r'leaves after 7\.6\d\d ms, alpha 3\.6\d\d\n', capsys.readouterr().out)


def test_table_of_topics_is_current():
    topics = pytest.importorskip('soft_throw_ros.nodes.topics', reason='needs rclpy')
    _, _, rest = TEXT.partition('<!-- topics -->\n')
    assert rest.partition('<!-- /topics -->')[0] == topics.markdown()


@pytest.mark.parametrize('path', re.findall(r'\]\(([^)#]+)\)', TEXT))
def test_what_is_linked_is_there(path):
    assert (README.parent / path).is_file()
