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
Identification of a rig from measured tracks: parameters with their uncertainties, without ROS.

`tracks` (read by `track_csv`, or followed in videos by `video`) are compared by `least_squares`
with a model: of the plate alone (`plate_fit`), of whole throws (`rig_model` as `fit_description`
says, run by `rig_fit`), or of a free layer (`ringing`). A fit of whole throws is started by
`layer_search`, which also tries other minima; then other models (`model_choice`) are tried to
first order (`linear_fit`), and effects that the tracks hardly show are added to the errors
(`unseen`). `fit_warnings` finds reasons to doubt a fit.
`forward` is the only module that calls the steppers of the core. `ejection` computes the first
release.
"""
