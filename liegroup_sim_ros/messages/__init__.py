# SPDX-License-Identifier: Apache-2.0
"""ROS messages as bytes: samples of the core to CDR, and back.

In: Samples, numbers, time stamps in nanoseconds. Out: CDR bytes and schemas. No ROS is imported;
no file, topic or clock is known here.
"""
