# SPDX-License-Identifier: Apache-2.0
"""One thread for BLAS, before any test loads NumPy: more make small solves slower."""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
