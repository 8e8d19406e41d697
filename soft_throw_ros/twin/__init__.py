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
"""
The twin without ROS: a sequence of steps, and a journal that repeats them exactly.

Notes
-----
`session.Session` receives requests, changes of settings and samples between steps, and writes
them to the journal. In each step `throw_cycle.ThrowCycle` advances the state of the rig: at rest,
a throw under way (`throws.ScheduledThrow` or `measured_throw.MeasuredThrow`), or returning.

A sample of a measured plate passes the following stations:

1. `plate_estimator.PlateEstimator` refuses it, or sorts it by its stamp. When it is complete,
   `outlier_filter` may remove it, and the samples of a window yield a smoothed state.
2. `plate_monitor.PlateMonitor` detects from smoothed states that a throw has begun, and finds the
   `Onset`. `sensor_checks` warns of faults.
3. In a throw, `plate_source.MeasuredPlate` fits the engine's motion to the samples (`engine_fit`).
   Either the fit or the smoothed states move the plate of a simulation.
4. `measured_throw` advances the simulation until the sample's time, which gives the residual, and
   forks of the simulation ahead of it, which give the displayed state and the predictions.
5. `results.Outputs` has the numbers of the step. `nodes` publishes them.

"""
