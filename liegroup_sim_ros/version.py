# SPDX-License-Identifier: Apache-2.0
"""Version of this package; setup.py and package.xml have the same, a test compares them."""

__version__ = "0.3.0"
