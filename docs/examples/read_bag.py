# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Plot the heights in a bag of the node /twin: read_bag.py BAG PICTURE."""

from pathlib import Path
import sys

from matplotlib import pyplot as plt
from rosbags.highlevel import AnyReader

bag, picture = map(Path, sys.argv[1:])
times, heights = [], []
with AnyReader([bag]) as reader:
    states = [item for item in reader.connections if item.topic == '/twin/joint_states']
    for connection, _, data in reader.messages(states):
        message = reader.deserialize(data, connection.msgtype)
        times.append(message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec)
        heights.append(1e3 * message.position)

plt.plot([time - times[0] for time in times], heights, label=['plate', 'projectile'])
plt.xlabel('time [s]')
plt.ylabel('height [mm]')
plt.legend()
plt.savefig(picture)
