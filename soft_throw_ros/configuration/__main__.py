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
"""Generate files of config/ and docs/ from the tables; run above both folders."""

from pathlib import Path

from soft_throw_ros.configuration.document import documents


def main(folder: Path) -> None:
    """Write every document below a folder."""
    for path, text in documents().items():
        (folder / path).write_text(text, 'utf-8')


if __name__ == '__main__':
    main(Path())
