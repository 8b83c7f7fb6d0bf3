# SPDX-License-Identifier: Apache-2.0
"""The command line liegroup_sim: one file per subcommand.

In: arguments. Out: files, tables and an exit code. Computations are elsewhere.
"""
