# SPDX-License-Identifier: Apache-2.0
"""What the processes of all tests have in common."""

import os
import signal

# One thread for BLAS, before any test loads NumPy: more make small solves slower.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# A shell starts a process in the background with SIGINT ignored, and so would be the Ctrl-C of the tests.
signal.signal(signal.SIGINT, signal.default_int_handler)
