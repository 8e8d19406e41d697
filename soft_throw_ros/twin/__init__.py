# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The twin without ROS: a sequence of steps, and a journal that repeats them exactly.

This package may import `configuration`, `core` and `storage`.

Notes
-----
`session.Session` receives requests, changes of settings and samples between steps, and writes
them to the journal. In each step it advances the state of the rig, see `rig_states`: at rest, a
throw under way (`ScheduledThrow` or `MeasuredThrow`), or returning to rest.

A sample of a measured plate passes the following stations:

1. `sample_buffer.SampleBuffer` refuses it, or sorts it by its stamp. When it is complete,
   `sample_buffer.OutlierFilter` may remove it.
2. `plate_monitor.PlateMonitor` detects from the smoothed speed of the plate that a throw has
   begun, and finds the `Onset`. It reports faults of the sensor.
3. In a throw, `plate_observer.PlateObserver` smooths the samples, and continues the motion ahead
   of them.
4. `rig_states.MeasuredThrow` advances the simulation along the smoothed plate, which gives the
   residual, and forks of it ahead, which give the displayed state and the predictions.
5. `results.Outputs` has the numbers of the step. `nodes` publishes them.

"""
