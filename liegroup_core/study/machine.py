# SPDX-License-Identifier: Apache-2.0
"""What a measured cost belongs to."""

import platform
from functools import lru_cache
from pathlib import Path


@lru_cache(maxsize=None)
def cpu_name():
    """The processor's name for people; where the system does not tell, its kind."""
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()
