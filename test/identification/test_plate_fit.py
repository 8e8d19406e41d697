# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Fitting the plate's motion to its track."""

from dataclasses import replace

import numpy as np
import pytest
from soft_throw_ros.core.plate import Underdamped
from soft_throw_ros.identification.least_squares import fit_warnings, FitError
from soft_throw_ros.identification.plate_fit import fit_plate, NAMES
from soft_throw_ros.identification.tracks import Track

TRUTH = {'frequency': 63.2, 'amplitude': 2e-3, 'damping_ratio': 0.064}
START = 0.0204


def track_of(motion, time, start, *, noise=0.0, offset=0.0, seed=0):
    scatter = noise * np.random.default_rng(seed).normal(size=time.size)
    return Track(time=time, position=offset + motion.position(time - start) + scatter)


# Least squares of the reference tracks, and Cramer-Rao bounds, by another program
REFERENCE = {
    'engine.frequency': (63.19175365382672, 0.01410801176804514),
    'engine.damping_ratio': (0.06406504136291553, 0.0001644711582044226),
    'engine.amplitude': (0.001999905450430715, 1.97091783799517e-06),
    'start_time': (0.02039991627309855, 5.526605082306597e-06),
    'plate_offset': (6.764128972192504e-07, 1.8030179883050006e-06),
}


def test_plate_fit_gives_the_reference_values(reference_throw):
    found = fit_plate(replace(reference_throw.plate, known_noise=2e-5))
    assert found.names == tuple(REFERENCE)
    for name, (value, error) in REFERENCE.items():
        assert found[name].value == pytest.approx(value, abs=1e-2 * error)
        assert found[name].error == pytest.approx(error, rel=5e-3)
    assert found.chi2 == pytest.approx(468.66172293788003, rel=1e-6)
    assert found.dof == 495
    assert fit_warnings(found) == []


@pytest.mark.parametrize('frequency', [4.0, 400.0])
@pytest.mark.parametrize('damping_ratio', [0.0, 0.064, 0.6])
@pytest.mark.parametrize('periods', [0.8, 25.0])
def test_plate_fit_needs_no_guess_and_accepts_gaps_and_jitter(frequency, damping_ratio, periods):
    motion = Underdamped(frequency=frequency, amplitude=5e-3, damping_ratio=damping_ratio)
    begin = -17.0
    share = np.sort(np.random.default_rng(5).uniform(0.0, 1.0, 1000))
    time = begin + (periods + 0.4) / frequency * share[(share < 0.6) | (share > 0.65)]
    start = begin + 0.4 / frequency
    found = fit_plate(track_of(motion, time, start, noise=3e-5, offset=0.7))
    truth = dict(zip(NAMES, (frequency, damping_ratio, 5e-3, start, 0.7), strict=True))
    for name, value in truth.items():
        assert found[name].value == pytest.approx(value, abs=4.5 * found[name].error), name


@pytest.mark.parametrize(('true', 'stated'), [(0.0, 1e-5), (5e-5, 5e-5), (1e-4, 1e-4)])
def test_stated_errors_of_stamps_are_part_of_the_noise(true, stated):
    rng = np.random.default_rng(3)
    time = np.arange(0.0, 0.1, 4e-4)
    exact = track_of(Underdamped(**TRUTH), time, START, noise=5e-6)
    errors = true * np.sqrt(3.0) * rng.uniform(-1.0, 1.0, time.size)
    late = replace(exact, time=time + errors, stamp_error=stated)
    found = fit_plate(late)
    assert 0.5 < found.reduced_chi2 < 1.2
    frequency = found['engine.frequency']
    assert frequency.value == pytest.approx(63.2, abs=3.5 * frequency.error)


def test_plate_that_falls_or_has_no_recorded_rise_or_no_damped_step_is_refused():
    motion, time = Underdamped(**TRUTH), np.arange(0.0, 0.2, 2e-4)
    to_and_fro = np.abs((time - 0.02).clip(0.0) / 0.03 % 2.0 - 1.0)
    late = (slice(round(begin / 2e-4), None) for begin in (0.025, 0.028, 0.06))
    for position, part, message in (
        (-motion.position(time - START), slice(500), r'goes down by about 0\.002 m'),
        (2e-3 - 2e-3 * to_and_fro, slice(None), 'does not move as a damped step'),
        *((motion.position(time - START), part, 'must begin before it moves') for part in late),
    ):
        with pytest.raises(FitError, match=message):
            fit_plate(Track(time=time[part], position=position[part]))
