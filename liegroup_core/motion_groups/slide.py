# SPDX-License-Identifier: Apache-2.0
"""R: a link moves along z of its frame; along x of it in a plane."""

NAME = "R"
JOINTS = {"prismatic": "the frames share their axes; the child translates along z (slider)"}
COMPONENTS, PLANE_COMPONENTS = (5,), (3,)
MAY_BE_HELD = True
