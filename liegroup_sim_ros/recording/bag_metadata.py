# SPDX-License-Identifier: Apache-2.0
"""Metadata of rosbag2: a record in each file, and the metadata.yaml of a folder.

Source: rosbag2 bag metadata version 9.
"""

import os
from contextlib import suppress
from textwrap import dedent, indent

import yaml

FILE_NAME = "metadata.yaml"
# Largest number of files for which each new file rewrites metadata.yaml. With more, it is rewritten less often:
# the cost per file does not grow with their number, and after a crash at most the last thousandth is missing.
AT_ONCE = 1000


class BagMetadata:
    """The files of a bag, added one by one."""

    def __init__(self):
        self._names, self._files = [], []  # entries of the files, YAML
        self._topics = {}  # name -> entry of topics_with_message_count
        self._count = 0  # messages
        self._spans = {}  # smallest and largest stamp of the files with messages (True) and of the others
        self._written = 0  # files in metadata.yaml

    def add_file(self, name, stamps, topics):
        """Add a complete file.

        name   : file name without folder
        stamps : smallest and largest stamp, ns; zeros without messages
        topics : [(topic_info(...), number of messages)]
        """
        first, last = stamps
        count = sum(number for _, number in topics)
        entry = {
            "path": name,
            "starting_time": {"nanoseconds_since_epoch": first},
            "duration": {"nanoseconds": last - first},
            "message_count": count,
        }
        self._names.append(_item(name))
        self._files.append(_item(entry))
        self._count += count
        start, end = self._spans.get(count > 0, stamps)
        self._spans[count > 0] = min(start, first), max(end, last)
        for info, number in topics:
            entry = self._topics.setdefault(info["name"], {"topic_metadata": info, "message_count": 0})
            entry["message_count"] += number

    def text(self):
        """The content of metadata.yaml."""
        first, last = self._spans.get(True) or self._spans[False]
        head = {
            "version": 9,
            "storage_identifier": "mcap",
            "duration": {"nanoseconds": last - first},
            "starting_time": {"nanoseconds_since_epoch": first},
            "message_count": self._count,
            "topics_with_message_count": list(self._topics.values()),
            "compression_format": "",
            "compression_mode": "",
            "custom_data": {},
            "ros_distro": "jazzy",
        }
        lists = ("relative_file_paths", self._names), ("files", self._files)
        return as_yaml({"rosbag2_bagfile_information": head}) + "".join(
            f"  {name}:\n{''.join(entries)}" for name, entries in lists
        )

    def is_due(self):
        """Whether enough files were added for metadata.yaml to be written again."""
        return len(self._files) - self._written > self._written // AT_ONCE

    def write(self, folder):
        """Write metadata.yaml atomically. Raises OSError."""
        path = folder / FILE_NAME
        new = path.with_suffix(".yaml.new")
        try:
            new.write_text(self.text(), encoding="utf-8")
            os.replace(new, path)
        finally:
            with suppress(OSError):
                new.unlink()
        self._written = len(self._files)


def _item(value):
    """Entry of a list in the metadata, YAML."""
    return indent(as_yaml([value]), "  ")


def record_of_file(name, stamps, topics):
    """{key: text} of the metadata record `rosbag2` of a file; arguments as in BagMetadata.add_file."""
    bag = BagMetadata()
    bag.add_file(name, stamps, topics)
    return {"serialized_metadata": dedent(bag.text().partition("\n")[2])}


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
