# SPDX-License-Identifier: Apache-2.0
"""Events of switches: when stops and friction change, and what an impact or a release changes.

In: a mechanism whose substep has ended, with guards at its stages. Out: the time of a change, impulses,
the new modes. Events do not depend on the method: the caller gives them the function that takes steps.
"""
