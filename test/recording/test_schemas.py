# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Definitions of message types, from installed packages and from texts."""

from pathlib import Path
import re

import pytest
from rosbags.typesys import get_types_from_msg, get_typestore, Stores
from soft_throw_ros.recording.schemas import find_schema, installed_prefixes, SchemaError

PREFIXES = installed_prefixes()
INSTALLED = sorted({
    f'{path.parts[-3]}/msg/{path.stem}'
    for prefix in PREFIXES for path in Path(prefix).glob('share/*/msg/*.msg')
})


@pytest.mark.parametrize('name', INSTALLED)
def test_text_has_the_hash_computed_by_rosbags(name):
    assert {'sensor_msgs/msg/JointState', 'diagnostic_msgs/msg/DiagnosticArray'} <= {*INSTALLED}
    definition, type_hash = find_schema(name, PREFIXES)
    if re.search(r'^char\b', definition, re.MULTILINE):
        pytest.skip('rosbags gives char a number of its own, where ROS takes that of uint8')
    types = get_typestore(Stores.EMPTY)
    types.register(get_types_from_msg(definition, name))
    assert type_hash == types.hash_rihs01(name)


def test_missing_type_is_named_with_the_searched_folders(tmp_path):
    with pytest.raises(SchemaError, match='a/msg/Top') as refusal:
        find_schema('a/msg/Top', [tmp_path, '/nowhere'])
    assert f'{tmp_path}/share, /nowhere/share' in str(refusal.value)
    for package in 'ab':
        (tmp_path / f'share/{package}/msg').mkdir(parents=True)
    (tmp_path / 'share/a/msg/Top.msg').write_text('b/Missing x\n')
    (tmp_path / 'share/a/msg/Top.json').write_text('{')
    with pytest.raises(SchemaError, match='b/msg/Missing'):
        find_schema('a/msg/Top', [tmp_path])
    (tmp_path / 'share/b/msg/Missing.msg').write_text('float64 x\n')
    with pytest.raises(SchemaError, match=r'a/msg/Top: .* cannot be read'):  # no hash
        find_schema('a/msg/Top', [tmp_path])
    for name in ('String', 'std_srvs/srv/Trigger', 'a/msg/../B'):
        with pytest.raises(SchemaError, match=f"'{name}'"):
            find_schema(name, PREFIXES)
