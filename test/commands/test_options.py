# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Options of a rig."""

import argparse

import pytest
from soft_throw_ros.commands.options import add_rig_options, read_settings, stated_parameters
from soft_throw_ros.configuration import TWIN


def test_named_parameter_is_set_like_an_option():
    parser = argparse.ArgumentParser()
    add_rig_options(parser, ['layer.thickness'])
    words = ['--thickness=0.01', '-p', 'layer.density:=1.1e3', '-p',
             'recommendation.frequencies:=[50, 7e1]', '-p', 'layer.thickness:=0.012']
    settings = read_settings(parser.parse_args(words))
    assert settings['layer.thickness'] == 0.012
    assert settings['layer.density'] == 1100.0
    assert settings['recommendation.frequencies'] == (50.0, 70.0)


LAYER = set(TWIN.names_in('layer'))


@pytest.mark.parametrize(
    ('words', 'text', 'stated'),
    [
        ((), '', set()),
        (('-p', 'layer.density:=900'), '', {'layer.density'}),
        (('--mass', '0.002'), '', {'projectile.mass'}),
        (('--layer', 'gelatin_16.8mm'), '', LAYER),
        (('--stack', '8e-3 7 1000'), '', LAYER),
        (('--layer', 'custom'), '', {'layer.name'}),
        ((), 'layer: {name: gelatin_16.8mm}', LAYER),
        (('-p', 'gravity:=0'), 'projectile: {mass: 0.002}', {'projectile.mass', 'gravity'}),
    ],
)
def test_options_and_file_state_parameters(write, words, text, stated):
    parser = argparse.ArgumentParser()
    add_rig_options(parser)
    if text:
        words += ('--config', str(write(f'twin: {{ros__parameters: {{{text}}}}}')))
    assert stated_parameters(parser.parse_args(words)) == stated
