# SPDX-License-Identifier: Apache-2.0
"""SO(2) x R: a link turns about z and moves along it."""

NAME = "SO(2) x R"
JOINTS = {
    "cylindrical": "the frames share the z axis; the child rotates about it and translates along it (shaft in a sleeve)"
}
COMPONENTS = (2, 5)
MAY_BE_HELD = True
