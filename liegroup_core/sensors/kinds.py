# SPDX-License-Identifier: Apache-2.0
"""All kinds of sensors. For a new kind, add a file with a class, and an entry in SENSORS."""

from .distance import DistanceSensor
from .encoder import Encoder
from .force_torque import ForceTorque
from .imu import Imu
from .pose import Pose

SENSORS = (Imu, ForceTorque, Encoder, Pose, DistanceSensor)
