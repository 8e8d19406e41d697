# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Columns of numbers in CSV files: separators, labels, units and refusals."""

import numpy as np
import pytest
from soft_throw_ros.configuration.csv_rows import Column, read_columns

COLUMNS = {
    't': Column(('t', 'time'), {'s': 1.0, 'ms': 1e-3}, 's'),
    'z': Column(('z', 'height'), {'m': 1.0, 'mm': 1e-3}, 'm', largest=10.0, may_have_gaps=True),
    'v': Column(('v',), {'m/s': 1.0}, 'm/s', needs_label=True),
}


def read(text):
    return read_columns(text.splitlines(), 'track.csv', COLUMNS)


@pytest.mark.parametrize(
    'text',
    [
        't [ms],z [mm],"a, note"\n0,1,"1,0"\n,,\n2,3,10\n',
        'time (ms);height (mm)\n0;1,0\n2;3,0\n',
        'sep=;\n# a comment\n\nt [ms]; z [mm]\n0; 1e0;\n2; 3;\n',
        '\ufeff"t [ms]"\t"z [mm]"\n0\t1\n2\t3\n',
        '0 0.001\n0.002 0.003\n',
        'z,t\n1e-3,0\n3e-3,2e-3\n',
    ],
)
def test_tables_of_spreadsheets_and_programs_have_the_same_numbers(text):
    columns = read(text)
    assert set(columns) == {'t', 'z'}
    assert columns['t'] == pytest.approx([0.0, 2e-3])
    assert columns['z'] == pytest.approx([1e-3, 3e-3])


def test_columns_may_need_a_label_or_have_gaps():
    assert 'v' not in read('0,1,5\n1,2,5\n')
    columns = read('t,z,v\n0,,5\n1,NA,6\n2,3,7\n')
    assert columns['v'].tolist() == [5.0, 6.0, 7.0]
    assert np.isnan(columns['z']).tolist() == [True, True, False]


@pytest.mark.parametrize(
    ('text', 'parts'),
    [
        ('', ('track.csv', 'empty')),
        ('t,z\n', ('track.csv:1', 'no line with numbers')),
        ('t,z [km]\n0,1\n', ('track.csv:1', 'm or mm', "'z [km]'")),
        ('t,z,height\n0,1,1\n', ('track.csv:1', 'once', "'height'")),
        ('t,z\n0,1\n0,2\n', ('track.csv:3', 'increase', '0 after 0')),
        ('t,z\n0,1\n,2\n', ('track.csv:3', 't must be a finite number', "''")),
        ('t,z\n0,11\n', ('track.csv:2', '+- 10', "'11'")),
        ('t,z\n0,1_000\n', ('track.csv:2', 'finite number', "'1_000'")),
        ('t,z\n0,\u0661\n', ('track.csv:2', 'finite number', "'\u0661'")),
        ('1\n2\n', ('track.csv:1', 'columns t and z', "'1'")),
        ('t,z\n0,1,2\n', ('track.csv:2', 'got 3')),
    ],
)
def test_wrong_table_is_refused_with_the_line_and_the_value(text, parts):
    with pytest.raises(ValueError) as caught:  # noqa: PT011 (the parts are compared below)
        read(text)
    assert all(part in str(caught.value) for part in parts), caught.value
