# SPDX-License-Identifier: Apache-2.0
"""Recordings: MCAP files that contain a simulation run and all that is needed to repeat it.

In: encoded messages with time stamps; the scene, settings and state of a simulation.
Out: arrays, tracks and events. This folder imports no rclpy, no analysis and no display.

Write    write.py        Recorder: queue, flushing, parts, failures of the disk
         write_mcap.py   chunks, message index, summary
         write_files.py  names of files and parts
         write_run.py    the files of `liegroup_sim run`
         checkpoints.py  states during the run
Read     read.py         Recording, read_recording: settings, tracks, events
         read_file.py    attachments, and one pass over the messages of the file
         frames.py       pandas DataFrames
         motion.py       blocks of samples between two resets
         check.py        whether settings, scene and state belong together
         tracks.py       array types of the results; addresses.py: paths, globs and URLs
Damaged  damaged_survey.py   counts and problems, for `info` and `recover`
         damaged_recover.py  a new file from the intact records
Shared   walk.py             one pass over a file: every intact record, messages as arrays
         mcap_records.py     single records, with bounds on all lengths
         attachments.py, bag_metadata.py   contents of the attachments; metadata of rosbag2

Why the library `mcap` is not used throughout. It encodes and parses all rare records: header,
schemas, channels, attachments, metadata, statistics, indexes, footer. Three tasks are done here:

* Writing and reading messages. The library creates an object per message: 3.5 us of CPU time to
  write one, Recorder 1.5 us (benchmarks/recording.py); some 5 us to read one, walk.py 0.1 us
  (benchmarks/recording_analysis.py).
* Files without an end. After SIGKILL or a full disk the summary is missing, and the library's
  indexed reader refuses the file. Its sequential reader stops at the first damaged record.
  walk.py searches for the next chunk with a correct checksum; of 200 processes killed at
  random, every file was recovered without a gap (benchmarks/recording.py).
* Hostile lengths. The library accepts records up to 4 GiB and decompresses a chunk to the size that
  it claims. mcap_records.py limits records and chunks to 64 MiB and a chunk to 1000 times its
  compressed size (test_hostile_logs.py, test_recover.py).
"""

from typing import TYPE_CHECKING

from .errors import RecordingError

if TYPE_CHECKING:
    from .read import read_recording

__all__ = ["RecordingError", "read_recording"]


def __getattr__(name):
    """Import the reader on first use: it loads NumPy and SciPy, which RecordingError does not need."""
    if name == "read_recording":
        from .read import read_recording

        return read_recording
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
