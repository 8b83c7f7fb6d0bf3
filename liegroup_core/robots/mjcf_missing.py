# SPDX-License-Identifier: Apache-2.0
"""MJCF models with missing mesh and picture files. It runs in a separate process, see apart.py.

MuJoCo's compiler refuses a model with a missing file. The motion depends on such a file only if the mass
of a body follows from a mesh. All other missing files are replaced by placeholders.
"""

import os
from contextlib import suppress

import mujoco

from liegroup_core.errors import MissingFileError

MESH_SCALE = (1.0, 1.0, 1.0)


def compiled_without_files(path):
    """(compiled model, {number of a geom: address of its mesh} of the missing meshes).

    Raises MissingFileError if the mass of a body follows from a missing mesh, PermissionError from one that this
    process may not open, and ValueError if other parts of the model are wrong.
    """
    spec = mujoco.MjSpec.from_file(path)
    missing = {}
    for mesh in spec.meshes:
        address = _missing(mesh.file, mesh.compiler.meshdir, spec)
        if address:
            missing[mesh.name] = address
            mesh.file, mesh.content_type, mesh.scale = "", "", MESH_SCALE
            mesh.make_sphere(subdivision=0)
    without = [geom for geom in spec.geoms if geom.meshname in missing]
    for geom in without:
        if _has_mass(geom, spec):
            with suppress(FileNotFoundError):
                open(os.path.join(spec.modelfiledir, missing[geom.meshname]), "rb").close()
            body = f'body "{geom.parent.name}"' if geom.parent.name else "a body without a name"
            raise MissingFileError(
                f"mesh file '{missing[geom.meshname]}' does not exist, and the mass of {body} follows "
                "from it: supply the file, or give the body an <inertial>"
            )
    _replace_pictures(spec)
    model = spec.compile()
    return model, {geom.id: missing[geom.meshname] for geom in without}


def _missing(file, folder, spec):
    """Address of a missing file relative to the model; "" if the file exists or `file` is empty."""
    if not file:
        return ""
    address = os.path.join(folder, os.path.basename(file) if spec.strippath else file)
    try:
        # A file that this process may not open counts as missing.
        with open(os.path.join(spec.modelfiledir, address), "rb"):
            return ""
    except OSError:
        return address


def _has_mass(geom, spec):
    """True if this geom contributes to the mass or inertia of a body."""
    rule, kinds = geom.compiler.inertiafromgeom, mujoco.mjtInertiaFromGeom
    if geom.parent.name == "world" or rule == kinds.mjINERTIAFROMGEOM_FALSE:
        return False
    if rule == kinds.mjINERTIAFROMGEOM_AUTO and geom.parent.explicitinertial:
        return False
    first, last = geom.compiler.inertiagrouprange
    own = geom.density if geom.mass != geom.mass else geom.mass  # NaN: not given
    return first <= geom.group <= last and own > 0.0


def _replace_pictures(spec):
    """Replace parts that only a viewer or contact needs: textures, height fields and skins."""
    for texture in spec.textures:
        if _missing(texture.file, texture.compiler.texturedir, spec) or any(
            _missing(file, texture.compiler.texturedir, spec) for file in texture.cubefiles
        ):
            texture.file, texture.content_type = "", ""
            texture.cubefiles = [""] * len(texture.cubefiles)
            texture.builtin = mujoco.mjtBuiltin.mjBUILTIN_FLAT
            texture.width = texture.height = 1
    for field in spec.hfields:
        if _missing(field.file, field.compiler.meshdir, spec):
            field.file, field.content_type = "", ""
            field.nrow = field.ncol = 2
            field.userdata = [0.0] * 4
    for skin in list(spec.skins):
        if _missing(skin.file, skin.compiler.meshdir, spec):
            spec.delete(skin)
