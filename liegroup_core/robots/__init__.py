# SPDX-License-Identifier: Apache-2.0
"""Robot descriptions: URDF, SDF and MJCF files as texts of scenes.

In: a file of a robot, and what the user adds to it. Out: the text of a scene file, with comments
that say what came from where, or one SceneError with file and line. It knows no Scene: a scene is
read from the text like any other, so a recording of a robot needs no other file.

    read.py                       which format a file has
    urdf.py, sdf.py, mjcf.py      file -> Robot, a neutral description (description.py)
    apart.py                      xacro, MuJoCo's compiler and readers of meshes, in processes of their own
    confined.py                   what takes the rights from these processes
    expressions.py                the check of xacro's expressions
    access.py                     which files a file may name
    meshes.py                     triangles that a viewer draws
    sdf_sensors.py, mjcf_sensors.py   sensors of a file
    options.py, additions.py      what a user adds: start values, closing joints, forces
    chains.py, links.py           links that stay, links that move as one, poses at the start
    sensors.py                    sensors of file and user, fixed joints that are kept for them
    mapping.py                    Robot -> bodies, joints, forces and notes of a scene
    text.py                       -> YAML with comments
"""
