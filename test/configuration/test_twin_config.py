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
"""The typed configuration of the twin."""

import numpy as np
import pytest
from soft_throw_ros.configuration import TWIN
from soft_throw_ros.configuration.twin_config import TwinConfig


def test_bounds_become_standard_deviations_of_uniform_errors() -> None:
    bounds = {'uncertainty.frequency': 0.7, 'uncertainty.damping_ratio': 0.02}
    measurement = TwinConfig.from_settings({**TWIN.defaults(), **bounds}).measurement
    within = np.linspace(-1.0, 1.0, 100_001)
    assert measurement.frequency_error == pytest.approx(np.std(0.7 * within), rel=1e-4)
    assert measurement.damping_error == pytest.approx(np.std(0.02 * within), rel=1e-4)
