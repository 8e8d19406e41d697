# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Identification of a rig from measured tracks: parameters with their uncertainties, without ROS.

`tracks` (read by `track_csv`, or followed in videos by `video`) are compared by `least_squares`
with a model: of the plate alone (`plate_fit`), of whole throws (`rig_model` as `fit_description`
says, run by `rig_fit`), or of a free layer (`ringing`). A fit of whole throws is started by
`layer_search`, which also tries other minima; a loss is tried, and systematic errors, which the
tracks hardly show, are added to the errors (`systematics`). `ejection` has the first release.

This package may import `twin`, `design` and the packages below them.
"""
