# SPDX-License-Identifier: Apache-2.0
"""Recordings: MCAP files of a run, written, read, surveyed and repaired.

In: encoded messages with time stamps and the attachments that make a recording self-contained.
Out: the same as arrays, tracks and events. Knows no rclpy, no analysis and no display.
"""

from .read import read_recording
from .tracks import RecordingError

__all__ = ["RecordingError", "read_recording"]
