# SPDX-License-Identifier: Apache-2.0
"""Lets the tests in this folder import its helpers; the package is the installed one."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
