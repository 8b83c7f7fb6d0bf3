# SPDX-License-Identifier: Apache-2.0
"""Name of the processor on which a cost was measured."""

import platform
from functools import lru_cache
from pathlib import Path


@lru_cache(maxsize=None)
def cpu_name():
    """Name of the processor, or its architecture if the system gives no name."""
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()
