# SPDX-License-Identifier: Apache-2.0
"""Robot descriptions: conversion of URDF, SDF and MJCF files to scene files.

Input: a robot file and the user's additions. Output: the text of a scene file, with comments on the
origin of each entry, or one SceneError with file and line. This package does not build a Scene: the text
is read like any scene file, so a recording of a robot needs no other file.

    read.py                       detects the format of a file
    urdf.py, sdf.py, mjcf.py      file -> Robot, a neutral description (description.py)
    apart.py                      xacro, MuJoCo's compiler and mesh readers, each in a separate process
    confined.py                   restricts the rights of these processes
    expressions.py                checks xacro's expressions
    access.py                     files that a robot file may refer to
    meshes.py                     triangles that a viewer draws
    sdf_sensors.py, mjcf_sensors.py   sensors of a file
    options.py, additions.py      the user's additions: start values, closing joints, forces
    chains.py, links.py           links to keep, links that move as one body, initial poses
    sensors.py                    sensors of file and user, and the fixed joints that they need
    mapping.py                    Robot -> bodies, joints, forces and notes of a scene
    text.py                       -> YAML with comments
"""
