# SPDX-License-Identifier: Apache-2.0
"""Live page in the browser: bodies, plots and controls of a simulation, a node or a recording.

In: a Source (simulation in this process, running node, recording). Out: a page at an address of this
machine. Sources know nothing of the page; the page asks them for frames at its own rate, so that none waits for it.
"""
