# SPDX-License-Identifier: Apache-2.0
"""The transport profile of Fast DDS; what it is good for is in `test_recorder_faults`."""

from __future__ import annotations

import os
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest
from soft_throw_ros.nodes.transport import use_transport_profile

VARIABLES = (
    'FASTDDS_BUILTIN_TRANSPORTS',
    'FASTDDS_DEFAULT_PROFILES_FILE',
    'FASTRTPS_DEFAULT_PROFILES_FILE',
)


@pytest.mark.parametrize('chosen', [None, *VARIABLES])
def test_profile_is_ours_unless_another_is_chosen(monkeypatch, chosen) -> None:
    for name in VARIABLES:
        monkeypatch.setenv(name, 'theirs')  # so that it is put back, whatever is done to it
        if name != chosen:
            monkeypatch.delenv(name)
    use_transport_profile()
    found = {name: os.environ[name] for name in VARIABLES if name in os.environ}
    if chosen is not None:
        assert found == {chosen: 'theirs'}
        return
    (path,) = found.values()
    assert Path(path).name == 'fastdds.xml'
    root = ET.parse(path).getroot()
    sizes = [int(item.text) for item in root.iter() if item.tag.endswith('queue_capacity')]
    assert min(sizes) > 5000  # messages of a second at the highest rate
