# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Let the node /twin choose the thickness of its layer, and apply its recommendation."""

import time

import rclpy
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from std_srvs.srv import Trigger

rclpy.init()
node = rclpy.create_node('chooser')
parameters = AsyncParameterClient(node, '/twin')
apply = node.create_client(Trigger, '/twin/apply_recommendation')
parameters.wait_for_services()


def answer(future):
    rclpy.spin_until_future_complete(node, future)
    return future.result()


vary = Parameter('recommendation.vary', value='thickness')
print(answer(parameters.set_parameters([vary])).results[0].reason or 'set')
while not (reply := answer(apply.call_async(Trigger.Request()))).success:
    time.sleep(0.5)  # it is being computed
print(reply.message)
thickness = answer(parameters.get_parameters(['layer.thickness'])).values[0].double_value
print(f'{thickness:.9g}')
