# SPDX-License-Identifier: Apache-2.0
"""Time integration methods, one folder per family; table.py lists all methods.

In: a layout, a method, a step, a state. Out: the state after n steps, or a status code. Methods
do not depend on scene files or clocks. `families.py` defines the interface of a family.
"""
