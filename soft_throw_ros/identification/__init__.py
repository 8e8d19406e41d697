# SPDX-License-Identifier: Apache-2.0
"""
From tracks to a rig: what was measured in, parameters with their uncertainties out. No ROS.

`tracks` (read by `track_csv`, or followed in videos by `video`) are compared by `least_squares`
with a model: of the plate alone (`plate_fit`), of whole throws (`rig_model` as `fit_description`
says, started by `layer_search`, run by `rig_fit`), or of a free layer (`ringing`). `forward` is
the only module that calls the steppers of the core. `throw_analysis` says how the projectile left.
"""
