# SPDX-License-Identifier: Apache-2.0
"""The command line liegroup_sim: one file a subcommand.

In: arguments. Out: files, tables and an exit code. What a command computes is elsewhere.
"""
