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
"""What holds for every test; nothing of ROS."""

from collections.abc import Iterator
import signal

import hypothesis
import numpy as np
import pytest
import strays

# The same examples in every run, and no deadline, for a first call compiles.
hypothesis.settings.register_profile('repeatable', deadline=None, derandomize=True)
# `make fuzz` has other examples in every run, and a failure says how to repeat it.
hypothesis.settings.register_profile('random', deadline=None, print_blob=True)
hypothesis.settings.load_profile('repeatable')

strays.watch_this_process()

# What tests start hears these signals, even if the tests themselves, run by nohup, do not.
for number in (signal.SIGINT, signal.SIGHUP):
    if signal.getsignal(number) == signal.SIG_IGN:
        signal.signal(number, lambda *_: None)


@pytest.fixture(autouse=True)
def floating_point_errors_raise() -> Iterator[None]:
    """Let no NaN or infinity arise unnoticed; what decays may underflow to zero."""
    with np.errstate(divide='raise', over='raise', invalid='raise'):
        yield
