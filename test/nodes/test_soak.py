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
"""A short run of `make soak`."""

import json

from bench import soak
import pytest


@pytest.mark.slow
@pytest.mark.once
@pytest.mark.timeout(300)
def test_promises_are_kept_for_half_a_minute(domain_id, tmp_path, capsys):
    pytest.importorskip('rerun')
    report = tmp_path / 'soak.json'
    code = soak.main(['--minutes', '0.5', '--sink', 'file', '--json', str(report)])
    output = capsys.readouterr().out
    assert code == 0, output
    result = json.loads(report.read_text())
    assert all(row['is_kept'] for row in result['promises'])
    assert result['processes'].keys() > {'twin', 'recorder', 'subscriber 4'}
    assert all(row['promise'] in output for row in result['promises'])
