# Copyright 2026 soft_throw_ros developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.
"""Help texts of the nodes: main parameters and examples agree with the tables."""

from __future__ import annotations

import re

import pytest
from soft_throw_ros.nodes.help_texts import HELP, help_text


@pytest.mark.parametrize('name', HELP)
def test_parameters_and_examples_follow_the_table(name) -> None:
    node = HELP[name]
    settings = re.findall(r'-p ([\w.]+):=(\S+)', node.example)
    assert settings
    for key, value in settings:
        default = node.table.by_name[key].default
        node.table.change(node.table.defaults(), {key: type(default)(value)})
    text = help_text(name, f'usage: {name}')
    assert text.startswith(f'usage: {name}\n')
    words = ' '.join(text.split())
    for key in node.parameters:
        assert f'{key} {node.table.by_name[key].meaning.replace("`", "")}' in words


def test_node_without_a_table_has_usage_only() -> None:
    assert help_text('replay', 'usage: replay BAG') == 'usage: replay BAG'
