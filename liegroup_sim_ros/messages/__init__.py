# SPDX-License-Identifier: Apache-2.0
"""ROS messages as bytes: samples of the core to CDR, and back.

In: Samples, numbers, time stamps in nanoseconds. Out: CDR bytes, message definitions, topics. This
folder imports no ROS and uses no files and no clocks.

Each message type is encoded in one place: a function of samples.py if a Sample is enough,
markers.py, diagnostics.py, estimates.py, or a class of codecs.py if messages are also decoded.
schemas.py finds the definition of any type. topics.py lists the topics of every recording.
"""
