# SPDX-License-Identifier: Apache-2.0
"""The command line liegroup_sim: one file per subcommand.

Input: arguments. Output: files, tables and an exit code. Other packages do the computations.
"""
