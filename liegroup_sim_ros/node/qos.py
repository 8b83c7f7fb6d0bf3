# SPDX-License-Identifier: Apache-2.0
"""Quality of service set by the user: parameters qos_overrides.TOPIC.KIND.POLICY.

TOPIC is a topic's full name, KIND is publisher or subscription, POLICY is depth or reliability. Only
parameters that the user sets are declared; otherwise there would be four per body.
"""

import difflib

from rclpy.qos import QoSPolicyKind
from rclpy.qos_overriding_options import QoSOverridingOptions

from .parameters import QOS_PREFIX, NodeParameterError

POLICIES = {"depth": QoSPolicyKind.DEPTH, "reliability": QoSPolicyKind.RELIABILITY}


class QosOverrides:
    """QoS parameters of a node.

    names : full names of the parameters
    """

    def __init__(self, names):
        self._names = names
        self._possible = []

    def options(self, node, topic, kind):
        """Options for creating the topic, None if no parameter is set for it."""
        names = {
            f"{QOS_PREFIX}{node.resolve_topic_name(topic)}.{kind}.{policy}": number
            for policy, number in POLICIES.items()
        }
        self._possible += names
        policies = [number for name, number in names.items() if name in self._names]
        return QoSOverridingOptions(policies) if policies else None

    def check(self):
        """Raise NodeParameterError for a name that belongs to no topic; call after creating all."""
        for name in self._names:
            if name not in self._possible:
                (near,) = difflib.get_close_matches(name, self._possible, n=1, cutoff=0.0)
                raise NodeParameterError(f"parameter {name}: unknown topic or policy; did you mean {near}?")
