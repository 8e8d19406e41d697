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


def install(prefix, name, text, description=None):
    path = prefix / 'share' / name.replace('/', '/msg/')
    path.parent.mkdir(parents=True, exist_ok=True)
    path.with_suffix('.msg').write_text(text)
    if description is not None:
        path.with_suffix('.json').write_text(description)


@pytest.mark.parametrize('name', INSTALLED)
def test_text_has_the_hash_computed_by_rosbags(name):
    assert {'sensor_msgs/msg/JointState', 'diagnostic_msgs/msg/DiagnosticArray'} <= {*INSTALLED}
    schema = find_schema(name, PREFIXES)
    if re.search(r'^char\b', schema.text, re.MULTILINE):
        pytest.skip('rosbags gives char a number of its own, where ROS takes that of uint8')
    types = get_typestore(Stores.EMPTY)
    types.register(get_types_from_msg(schema.text, name))
    assert schema.type_hash == types.hash_rihs01(name)


def test_text_is_assembled_as_by_rosbag2(tmp_path):
    texts = {
        'a/Top': 'b/Second[] list\nOwn own # b/Not\nb/First first\nstring text "b/Nor"\n',
        'a/Own': 'b/msg/First again\nint32 NUMBER=3\n',
        'b/First': 'float64 x\n',
        'b/Second': 'First[<=3] a\nFirst[2] b\nstring<=10 c\nwstring[<=2] d\n',
    }
    for name, text in texts.items():
        install(tmp_path, name, text)
    _, *others = (f'\n{"=" * 80}\nMSG: {name}\n{text}' for name, text in texts.items())
    assert find_schema('a/msg/Top', [tmp_path]).text == texts['a/Top'] + ''.join(others)


def test_missing_type_is_named_with_the_searched_folders(tmp_path):
    with pytest.raises(SchemaError, match='a/msg/Top') as refusal:
        find_schema('a/msg/Top', [tmp_path, '/nowhere'])
    assert f'{tmp_path}/share, /nowhere/share' in str(refusal.value)
    install(tmp_path, 'a/Top', 'b/Missing x\n', '{')
    with pytest.raises(SchemaError, match='b/msg/Missing'):
        find_schema('a/msg/Top', [tmp_path])
    install(tmp_path, 'b/Missing', 'float64 x\n')
    with pytest.raises(SchemaError, match=r'a/msg/Top: .* cannot be read'):  # no hash
        find_schema('a/msg/Top', [tmp_path])
    for name in ('String', 'std_srvs/srv/Trigger', 'a/msg/../B'):
        with pytest.raises(SchemaError, match=f"'{name}'"):
            find_schema(name, PREFIXES)
