# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Let the node /twin choose a layer of the library, and apply its recommendation."""

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


vary = Parameter('recommendation.vary', value='library')
print(answer(parameters.set_parameters([vary])).results[0].reason or 'set')
while not (reply := answer(apply.call_async(Trigger.Request()))).success:
    time.sleep(0.5)  # it is being computed
print(reply.message)
print(answer(parameters.get_parameters(['layer.name'])).values[0].string_value)
