# SPDX-License-Identifier: Apache-2.0
"""Commands for joints: decoding and validation of JointState and Float64MultiArray.

Names are those of ~/joint_states. A message may have some of the joints. NaN or an empty field gives no
command of its kind. A command replaces the previous one of the same joint and kind. An effort acts on
the joint itself. Position and velocity are targets of its servo, or the state that a driven joint reaches.

A command starts at its stamp if that is in the future, else with the next step; a stamp older than the
command's duration is refused. A message is accepted or refused as a whole; refusals are counted by reason.
"""

import math

from liegroup_core.fields.values import LARGEST_NUMBER
from liegroup_core.forces.commands import EFFORT, MOVE, TARGET, Command
from liegroup_sim_ros.messages.commands import JointStateDecoder, decode_array
from liegroup_sim_ros.numbers import counted

from .counted_input import LONGEST_NAME
from .joint_input import OF_JOINTS, JointInput

OLDEST = 1.0  # s; largest age of the stamp of a command without a duration
SOURCE = "joint_commands"
_is_exceeded = LARGEST_NUMBER.__lt__
INTERFACES = ("position", "velocity", "effort")  # in the order of a JointState
REASONS = (
    *OF_JOINTS,
    "no_position",
    "jump_too_large",
    "beyond_limits",
    "stamp_too_old",
    "stamp_too_far",
    "too_many",
    "damaged",
)


class JointCommandInput(JointInput):
    """Decoder and counter of commands for the joints of a scene.

    seconds : time in which a driven joint reaches a commanded position or velocity
    layout, present : as in JointInput
    """

    def __init__(self, layout, seconds, present=None):
        super().__init__("joint command", "joint_commands", REASONS, layout, present)
        self._seconds = seconds
        self._decoder = JointStateDecoder(self.most_names)
        self._checked = ()  # names of the last accepted message

    def read_array(self, payload, names, interface, held, jumps=None):
        """Same as `read`, for a serialized Float64MultiArray with one number per joint.

        names     : joints in the order of the numbers
        interface : "position", "velocity" or "effort"
        """
        numbers = self.decoded(decode_array, payload, self.most_names)
        if len(numbers) != len(names):
            self.refuse(
                "wrong_length",
                lambda: f"{counted(len(numbers), 'number')} for the {counted(len(names), 'joint')} of command_joints",
            )
        fields = [numbers if kind == interface else () for kind in INTERFACES]
        return self._commands(names, fields, 0, 0, held, None, jumps)

    def read(self, payload, now_ns, held, lasting, stamped=True, jumps=None, source=SOURCE):
        """[Command] of a serialized JointState. Raises Refusal.

        now_ns  : current stamp
        held    : number of commands that act now or start later
        lasting : s, duration of a command; None: until the next one
        stamped : False: time stamps are ignored
        jumps   : Jumps, or None for no limit
        source  : of its efforts; those of different sources add
        """
        stamp_ns, names, *fields = self.decoded(self._decoder.decode, payload)
        stamp_ns = stamp_ns if stamped else 0
        return self._commands(names, fields, stamp_ns, now_ns, held, lasting, jumps, source)

    def read_rates(self, rates, stamp_ns, now_ns, held, lasting):
        """Same as `read`, for wanted rates {joint of the scene: rad/s or m/s}; servos keep their target positions."""
        labels = {joint: name for name, joint in self.joints.items()}
        for joint, rate in rates.items():
            if not abs(rate) <= LARGEST_NUMBER:
                self.refuse("not_finite", lambda joint=joint: f"the velocity of {joint} is not finite or too large")
        names = [labels[joint] for joint in rates]
        fields = [(), list(rates.values()), ()]
        return self._commands(names, fields, stamp_ns, now_ns, held, lasting, None)

    def _commands(self, names, fields, stamp_ns, now_ns, held, lasting, jumps, source=SOURCE):
        if names != self._checked:
            self.check_names(names)
        for kind, values in zip(INTERFACES, fields):
            if len(values) not in (0, len(names)):
                self.refuse(
                    "wrong_length",
                    lambda: (
                        f"{counted(len(values), 'value')} of {kind} for "
                        f"{counted(len(names), 'name')}; give one per name (NaN: no command), or none"
                    ),
                )
            if any(map(_is_exceeded, map(abs, values))):
                name = next(name for name, value in zip(names, values) if abs(value) > LARGEST_NUMBER)
                self.refuse("not_finite", lambda: f"{kind} of {name} is infinite or too large")
        position, velocity, effort = fields
        wanted = []
        if position or velocity:
            none = (math.nan,) * len(names)
            targets = zip(names, position or none, velocity or none)
            wanted = [(name, *target) for name, *target in targets if not all(map(math.isnan, target))]
            self._check_servos(wanted, jumps)
        efforts = [(self.joints[name], value) for name, value in zip(names, effort) if not math.isnan(value)]
        for joint, value in efforts:
            self.refuse_beyond_limits(self.limits[joint].check_effort, value)
        target = ", ".join(names)
        age = OLDEST if lasting is None else lasting
        if stamp_ns and stamp_ns < now_ns - round(age * 1e9):
            self.refuse(
                "stamp_too_old",
                lambda: (
                    f"for {target:.{LONGEST_NAME}}: its time stamp {stamp_ns * 1e-9:.9g} s is more "
                    f"than {age:g} s before the simulated time {now_ns * 1e-9:.9g} s; use a zero "
                    "stamp, or simulated time (use_sim_time)"
                ),
            )
        self.refuse_far_stamp(stamp_ns, now_ns, f"{target:.{LONGEST_NAME}}")
        self.refuse_too_many(held, f"{target:.{LONGEST_NAME}}")
        start_ns = stamp_ns if stamp_ns > now_ns else None
        targets = [self._target(name, position, _or_zero(velocity), start_ns) for name, position, velocity in wanted]
        if self._present is not None:
            for command in targets:
                self.refuse_beyond_limits(self._present.check, command)
        self.accepted += 1
        self._checked = names
        return [Command(EFFORT, joint, (value,), start_ns, None, source) for joint, value in efforts] + targets

    def _target(self, name, position, velocity, start_ns):
        joint = self.joints[name]
        if name in self.driven:
            return Command(MOVE, joint, (position, velocity, self._seconds), start_ns)
        return Command(TARGET, joint, (_or_zero(position), velocity), start_ns)

    def _check_servos(self, wanted, jumps):
        for name, position, velocity in wanted:
            is_driven = name in self.driven
            if name not in self.servos and not is_driven:
                kind = "velocity" if math.isnan(position) else "position"
                self.no_servo(name, f"has no servo and is not driven, so it takes no {kind}, only an effort")
            if math.isnan(position) and not is_driven and self.servos[name]:
                self.refuse(
                    "no_position",
                    lambda: (
                        f"{name} has a velocity but no position, and its servo has a stiffness: "
                        "give a position too, or a servo with stiffness 0"
                    ),
                )
            limits = self.limits[self.joints[name]]
            if not math.isnan(velocity):
                self.refuse_beyond_limits(limits.check_velocity, velocity)
            if math.isnan(position):
                continue
            self.refuse_beyond_limits(limits.check_position, position)
            if jumps is None:
                continue
            if is_driven or self.servos[name]:
                self.refuse_jump(name, jumps.positions.get(self.joints[name], math.nan), position, jumps.most)


def _or_zero(value):
    return 0.0 if math.isnan(value) else value
