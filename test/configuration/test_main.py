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
from pathlib import Path

import pytest
from soft_throw_ros.configuration.__main__ import documents

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize(('path', 'text'), documents().items())
def test_document_is_current(path: str, text: str) -> None:
    """The command `python -m soft_throw_ros.configuration` updates the document."""
    assert (ROOT / path).read_text('utf-8') == text
