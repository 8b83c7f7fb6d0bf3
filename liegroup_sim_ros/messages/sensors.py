# SPDX-License-Identifier: Apache-2.0
"""Messages of the sensors of a scene.

Variances are those of a sensor's noise plus those of its body, see estimates.py.
"""

from .cdr import Template, stamp
from .codecs import WrenchStampedCodec
from .commands import JOINT_STATE, joint_state_template
from .estimates import covariance, variances

ODOMETRY = "nav_msgs/msg/Odometry"


def sensors(layout, world_frame, frame_prefix=""):
    """[(topic, type, encode)] of all sensors; arguments and result as in samples.py.

    imu ~/SENSOR/imu, force_torque ~/SENSOR/wrench, encoder ~/SENSOR/joint_state, pose
    ~/SENSOR/odometry, distance ~/SENSOR/distance.
    """
    return [
        (f"~/{sensor.name}/{topic}", message_type, make(sensor, world_frame, frame_prefix))
        for sensor in layout.scene.sensors
        for topic, message_type, make in [KINDS[sensor.type]]
    ]


def odometry_template(world_frame, child_frame):
    """Template of a nav_msgs/Odometry; its slots are the stamp, pose, its covariance, twist, its covariance."""
    template = Template()
    template.header(world_frame)
    template.string(child_frame)
    for numbers in ("7d", "6d"):
        template.slot(numbers)
        template.slot("36d")
    return template


def _of_axes(variance):
    """Covariance matrix (9,), the same about every axis."""
    return [variance, 0.0, 0.0, 0.0, variance, 0.0, 0.0, 0.0, variance]


def _imu(sensor, _world_frame, frame_prefix):
    template = Template()
    template.header(frame_prefix + sensor.name)
    for size in (4, 3, 3):
        template.slot(f"{size}d")
        template.slot("9d")

    def encode(stamp_ns, sample):
        values = sample.sensors[sensor.name].tolist()
        _, attitude, _, spin = variances(sample, sensor.body)
        turning = sensor.angular_velocity_noise**2 + spin
        return template.pack(
            stamp(stamp_ns),
            values[:4],
            _of_axes(attitude),
            values[4:7],
            _of_axes(turning),
            values[7:],
            _of_axes(sensor.acceleration_noise**2),
        )

    return encode


def _force_torque(sensor, _world_frame, frame_prefix):
    codec = WrenchStampedCodec(f"{frame_prefix}{sensor.name}")
    return lambda stamp_ns, sample: codec.encode(stamp_ns, sample.sensors[sensor.name])


def _encoder(sensor, _world_frame, _frame_prefix):
    pack, nothing = joint_state_template([sensor.joint]).pack, [float("nan")]  # not measured
    return lambda stamp_ns, sample: pack(stamp(stamp_ns), sample.sensors[sensor.name].tolist(), nothing, nothing)


def _pose(sensor, world_frame, frame_prefix):
    template = odometry_template(world_frame, frame_prefix + sensor.name)

    def encode(stamp_ns, sample):
        values = sample.sensors[sensor.name].tolist()
        place, attitude, speed, spin = variances(sample, sensor.body)
        place += sensor.position_noise**2
        return template.pack(
            stamp(stamp_ns), values[:7], covariance(place, attitude), values[7:], covariance(speed, spin)
        )

    return encode


def _distance(sensor, _world_frame, _frame_prefix):
    template = Template()
    template.slot("1d")
    return lambda stamp_ns, sample: template.pack(sample.sensors[sensor.name][:1].tolist())


KINDS = {
    "imu": ("imu", "sensor_msgs/msg/Imu", _imu),
    "force_torque": ("wrench", WrenchStampedCodec.TYPE, _force_torque),
    "encoder": ("joint_state", JOINT_STATE, _encoder),
    "pose": ("odometry", ODOMETRY, _pose),
    "distance": ("distance", "std_msgs/msg/Float64", _distance),
}
