# SPDX-License-Identifier: Apache-2.0
"""Compiled MuJoCo model as lists and numbers. It runs in a separate process, see apart.py."""

import mujoco
import numpy as np

from .mjcf_missing import compiled_without_files


def arrays_of(path):
    """Dict of JSON types of the model of an MJCF file. Quaternions are w, x, y, z, as in MuJoCo."""
    model, without_file = _compiled(path)
    off = model.opt.disableflags
    return {
        "name": _text(model.names, 0),
        "gravity": [0.0] * 3 if off & mujoco.mjtDisableBit.mjDSBL_GRAVITY else model.opt.gravity.tolist(),
        "fluid": bool(model.opt.density or model.opt.viscosity),
        "bodies": [_body(model, i) for i in range(1, model.nbody)],
        "joints": [_joint(model, i) for i in range(model.njnt)],
        "equalities": [_equality(model, i) for i in range(model.neq)],
        "geoms": [_geom(model, i) | {"missing": without_file.get(i, "")} for i in range(model.ngeom)],
        "tendons": [
            {
                "name": model.tendon(i).name or f"tendon_{i}",
                "force": bool(
                    model.tendon_stiffness[i]
                    or model.tendon_damping[i]
                    or model.tendon_frictionloss[i]
                    or model.tendon_limited[i]
                    or model.tendon_armature[i]
                ),
            }
            for i in range(model.ntendon)
        ],
        "actuators": [
            {
                "name": model.actuator(i).name or f"actuator_{i}",
                "acts": bool(
                    model.actuator_biastype[i] != mujoco.mjtBias.mjBIAS_NONE and model.actuator_biasprm[i].any()
                ),
            }
            for i in range(model.nu)
        ],
        "sensors": [_sensor(model, i) for i in range(model.nsensor)],
        "flexes": [f"flex_{i}" for i in range(model.nflex)],
        "plugins": [f"plugin_{i}" for i in range(model.nplugin)],
        "keys": [
            {
                "name": model.key(i).name or f"key_{i}",
                "qpos": model.key_qpos[i].tolist(),
                "qvel": model.key_qvel[i].tolist(),
            }
            for i in range(model.nkey)
        ],
        "qpos0": model.qpos0.tolist(),
    }


def _compiled(path):
    """(compiled model, {number of a geom: address of its mesh} of the missing meshes)."""
    try:
        return mujoco.MjModel.from_xml_path(path), {}
    except ValueError as error:
        if "Error opening file" not in str(error):
            raise
    return compiled_without_files(path)


def _text(names, start):
    """Null-terminated text in a buffer."""
    return bytes(names[start:]).split(b"\0", 1)[0].decode(errors="replace")


def _body(model, i):
    return {
        "name": model.body(i).name,
        "parent": int(model.body_parentid[i]),
        "pos": model.body_pos[i].tolist(),
        "quat": model.body_quat[i].tolist(),
        "ipos": model.body_ipos[i].tolist(),
        "iquat": model.body_iquat[i].tolist(),
        "mass": float(model.body_mass[i]),
        "inertia": model.body_inertia[i].tolist(),
        "gravcomp": float(model.body_gravcomp[i]),
        "mocap": bool(model.body_mocapid[i] >= 0),
    }


def _joint(model, i):
    dof, at, kind = model.jnt_dofadr[i], model.jnt_qposadr[i], int(model.jnt_type[i])
    return {
        "name": model.joint(i).name,
        "type": ("free", "ball", "slide", "hinge")[kind],
        "body": int(model.jnt_bodyid[i]),
        "pos": model.jnt_pos[i].tolist(),
        "axis": model.jnt_axis[i].tolist(),
        "qpos": int(at),
        "dof": int(dof),
        "zero": float(model.qpos0[at]),
        "spring": float(model.qpos_spring[at]),
        "stiffness": float(model.jnt_stiffness[i]),
        "damping": float(model.dof_damping[dof]),
        "nonlinear": bool(np.any(model.jnt_stiffnesspoly[i]) or np.any(model.dof_dampingpoly[dof])),
        "armature": float(model.dof_armature[dof]),
        "friction": float(model.dof_frictionloss[dof]),
        "range": model.jnt_range[i].tolist() if model.jnt_limited[i] else None,
    }


def _equality(model, i):
    kind = mujoco.mjtEq(int(model.eq_type[i])).name.removeprefix("mjEQ_").lower()
    first, second = int(model.eq_obj1id[i]), int(model.eq_obj2id[i])
    found = {
        "name": model.equality(i).name or f"{kind}_{i}",
        "type": kind,
        "first": first,
        "second": second,
        "data": model.eq_data[i].tolist(),
        "active": bool(model.eq_active0[i]),
    }
    if kind in ("connect", "weld") and model.eq_objtype[i] == mujoco.mjtObj.mjOBJ_SITE:
        found["sites"] = [_site(model, site) for site in (first, second)]
    if kind == "tendon" and second < 0:
        start, count = model.tendon_adr[first], model.tendon_num[first]
        if model.wrap_type[start : start + count].tolist() == [mujoco.mjtWrap.mjWRAP_SITE] * 2:
            found["tendon"] = int(first)
            found["sites"] = [_site(model, site) for site in model.wrap_objid[start : start + 2]]
            # The constraint prescribes the length relative to that in the pose of the file.
            found["length"] = float(model.tendon_length0[first] + model.eq_data[i][0])
    return found


def _sensor(model, i):
    """Sensor with its site or the number of its joint; plain: it has no cutoff and no reference frame."""
    kind, thing = int(model.sensor_objtype[i]), int(model.sensor_objid[i])
    return {
        "name": model.sensor(i).name or f"sensor_{i}",
        "type": mujoco.mjtSensor(int(model.sensor_type[i])).name.removeprefix("mjSENS_").lower(),
        "site": _site(model, thing) if kind == mujoco.mjtObj.mjOBJ_SITE else None,
        "joint": thing if kind == mujoco.mjtObj.mjOBJ_JOINT else None,
        "plain": not model.sensor_cutoff[i] and int(model.sensor_refid[i]) < 0,
    }


def _site(model, i):
    return {
        "name": model.site(i).name,
        "number": int(i),
        "body": int(model.site_bodyid[i]),
        "pos": model.site_pos[i].tolist(),
        "quat": model.site_quat[i].tolist(),
    }


def _geom(model, i):
    kind = mujoco.mjtGeom(int(model.geom_type[i])).name.removeprefix("mjGEOM_").lower()
    return {
        "body": int(model.geom_bodyid[i]),
        "type": kind,
        "size": model.geom_size[i].tolist(),
        "pos": model.geom_pos[i].tolist(),
        "quat": model.geom_quat[i].tolist(),
        "collides": bool(model.geom_contype[i] or model.geom_conaffinity[i]),
    }
