# SPDX-License-Identifier: Apache-2.0
"""Metadata of rosbag2: a record in each file, and the metadata.yaml of a folder.

Source: rosbag2 bag metadata version 9.
"""

import os

import yaml

FILE_NAME = "metadata.yaml"


class Bag:
    """The files of a bag, added one by one."""

    def __init__(self):
        self._files = []
        self._topics = {}  # name -> entry of topics_with_message_count

    def add_file(self, name, stamps, topics):
        """Add a complete file.

        name   : file name without folder
        stamps : smallest and largest stamp, ns; zeros without messages
        topics : [(topic_info(...), number of messages)]
        """
        first, last = stamps
        self._files.append(
            {
                "path": name,
                "starting_time": {"nanoseconds_since_epoch": first},
                "duration": {"nanoseconds": last - first},
                "message_count": sum(count for _, count in topics),
            }
        )
        for info, count in topics:
            entry = self._topics.setdefault(
                info["name"], {"topic_metadata": info, "message_count": 0}
            )
            entry["message_count"] += count

    def description(self):
        """The metadata as plain types, for YAML."""
        files = [file for file in self._files if file["message_count"]] or self._files
        starts = [file["starting_time"]["nanoseconds_since_epoch"] for file in files]
        ends = [start + file["duration"]["nanoseconds"] for start, file in zip(starts, files)]
        return {
            "version": 9,
            "storage_identifier": "mcap",
            "duration": {"nanoseconds": max(ends) - min(starts)},
            "starting_time": {"nanoseconds_since_epoch": min(starts)},
            "message_count": sum(file["message_count"] for file in self._files),
            "topics_with_message_count": list(self._topics.values()),
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": [file["path"] for file in self._files],
            "files": self._files,
            "custom_data": {},
            "ros_distro": "jazzy",
        }

    def write(self, folder):
        """Write metadata.yaml atomically. Raises OSError."""
        path = folder / FILE_NAME
        new = path.with_suffix(".yaml.new")
        new.write_text(
            as_yaml({"rosbag2_bagfile_information": self.description()}), encoding="utf-8"
        )
        os.replace(new, path)


def record_of_file(name, stamps, topics):
    """{key: text} of the metadata record `rosbag2` of a file; arguments as in Bag.add_file."""
    bag = Bag()
    bag.add_file(name, stamps, topics)
    return {"serialized_metadata": as_yaml(bag.description())}


def topic_info(topic, msg_type, qos, type_hash):
    """rosbag2's description of a topic; qos: list of schemas.qos_profile."""
    return {
        "name": topic,
        "type": msg_type,
        "serialization_format": "cdr",
        "offered_qos_profiles": qos,
        "type_description_hash": type_hash,
    }


class _Dumper(yaml.SafeDumper):
    def ignore_aliases(self, data):  # rosbag2's reader takes values, not references
        return True


def as_yaml(data):
    """YAML text as rosbag2 reads it: values, no references."""
    return yaml.dump(data, Dumper=_Dumper, sort_keys=False, allow_unicode=True)
