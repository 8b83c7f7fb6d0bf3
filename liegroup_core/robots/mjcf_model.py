# SPDX-License-Identifier: Apache-2.0
"""Compiled MuJoCo model as lists and numbers. It runs in a separate process, see apart.py."""

import functools

import mujoco
import numpy as np

from .mjcf_missing import compiled_without_files

DEFAULT_COLOR = np.array([0.5, 0.5, 0.5, 1.0], dtype=np.float32)  # of a geom that has none


def arrays_of(path):
    """Dict of JSON types of the model of an MJCF file. Quaternions are w, x, y, z, as in MuJoCo."""
    model, without_file = _compiled(path)
    _switch_off(model)
    return {
        "name": _text(model.names, 0),
        "gravity": model.opt.gravity.tolist(),
        "fluid": bool(model.opt.density or model.opt.viscosity),
        "bodies": [_body(model, i) for i in range(1, model.nbody)],
        "joints": [_joint(model, i) for i in range(model.njnt)],
        "equalities": [_equality(model, i) for i in range(model.neq)],
        "geoms": [_geom(model, i) | {"missing": without_file.get(i, "")} for i in range(model.ngeom)],
        "tendons": [_tendon(model, i) for i in range(model.ntendon)],
        "actuators": [_actuator(model, i) for i in range(len(model.actuator_trntype)) if not _is_off(model, i)],
        "sensors": [_sensor(model, i) for i in range(model.nsensor)],
        "flexes": [f"flex_{i}" for i in range(model.nflex)],
        "skins": [f"skin_{i}" for i in range(model.nskin)],
        "plugins": [f"plugin_{i}" for i in range(model.nplugin)],
        "keys": [
            _of(model, "key", i, "qpos", "qvel", "ctrl", "act")
            | {"name": model.key(i).name or f"key_{i}", "mocap": _moves_mocap(model, i)}
            for i in range(model.nkey)
        ],
        "qpos0": model.qpos0.tolist(),
    }


def _compiled(path):
    """(compiled model, {number of a geom: address of its mesh} of the missing meshes)."""
    try:
        return mujoco.MjModel.from_xml_path(path), {}
    except ValueError:
        return compiled_without_files(path)


def _text(names, start):
    """Null-terminated text in a buffer."""
    return bytes(names[start:]).split(b"\0", 1)[0].decode(errors="replace")


def _of(model, kind, i, *names, **other):
    """{name: value} of element i in the arrays KIND_NAME of a model; other : {key: name} of those with another key."""
    names = dict(zip(names, names)) | other
    return {key: getattr(model, f"{kind}_{name}")[i].tolist() for key, name in names.items()}


def _body(model, i):
    same = ("pos", "quat", "ipos", "iquat", "mass", "inertia", "gravcomp")
    return _of(model, "body", i, *same, parent="parentid", mocap="mocapid") | {"name": model.body(i).name}


def _switch_off(model):
    """Set what the flags of the file switch off to zero."""
    kinds, flags = mujoco.mjtDisableBit, int(model.opt.disableflags)
    parts = {
        kinds.mjDSBL_SPRING: (model.jnt_stiffness, model.jnt_stiffnesspoly, model.tendon_stiffness),
        kinds.mjDSBL_DAMPER: (
            model.dof_damping,
            model.dof_dampingpoly,
            model.tendon_damping,
            model.actuator_damping,
            model.actuator_dampingpoly,
        ),
        kinds.mjDSBL_FRICTIONLOSS: (model.dof_frictionloss, model.tendon_frictionloss),
        kinds.mjDSBL_LIMIT: (model.jnt_limited, model.tendon_limited),
        kinds.mjDSBL_EQUALITY: (model.eq_active0,),
        kinds.mjDSBL_CONTACT: (model.geom_contype, model.geom_conaffinity),
        kinds.mjDSBL_GRAVITY: (model.opt.gravity, model.body_gravcomp),
        kinds.mjDSBL_CLAMPCTRL: (model.actuator_ctrllimited,),
    }
    constraints = (kinds.mjDSBL_FRICTIONLOSS, kinds.mjDSBL_LIMIT, kinds.mjDSBL_EQUALITY, kinds.mjDSBL_CONTACT)
    for flag, arrays in parts.items():
        if flags & flag or (flags & kinds.mjDSBL_CONSTRAINT and flag in constraints):
            for array in arrays:
                array[:] = 0
    if flags & (kinds.mjDSBL_CONTACT | kinds.mjDSBL_CONSTRAINT):
        model.pair_geom1[:] = model.pair_geom2[:] = -1
    if flags & kinds.mjDSBL_SPRING and flags & kinds.mjDSBL_DAMPER:  # then MuJoCo has no passive forces
        model.body_gravcomp[:] = model.opt.density = model.opt.viscosity = 0.0


def _is_off(model, i):
    """Whether the file switches an actuator off."""
    group = int(model.actuator_group[i])
    return bool(
        model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_ACTUATION
        or (0 <= group < 31 and int(model.opt.disableactuator) >> group & 1)
    )


def _gear(model, i):
    return float(model.actuator_gear[model.actuator_outadr[i], 0])


def _actuator(model, i):
    """Actuator; shares: [[joint, change of its length by the coordinate]], None if this is not constant."""
    gains, biases, dynamics = mujoco.mjtGain, mujoco.mjtBias, mujoco.mjtDyn
    gain, bias = gains(int(model.actuator_gaintype[i])), biases(int(model.actuator_biastype[i]))
    at, dynamic = int(model.actuator_ctrladr[i]), int(model.actuator_dyntype[i])
    known = {
        dynamics.mjDYN_NONE: "none",
        dynamics.mjDYN_INTEGRATOR: "integrator",
        dynamics.mjDYN_FILTER: "filter",
        dynamics.mjDYN_FILTEREXACT: "filter",
    }
    gain_terms = {gains.mjGAIN_FIXED: 1, gains.mjGAIN_AFFINE: 3}.get(gain, 0)
    bias_terms = 3 * (bias == biases.mjBIAS_AFFINE)
    shares, forces = _shares(model, i), model.actuator_forcerange[i] if model.actuator_forcelimited[i] else None
    tendon = int(model.actuator_trnid[i, 0])
    if model.actuator_trntype[i] == mujoco.mjtTrn.mjTRN_TENDON and model.tendon_actfrclimited[tendon]:
        own = (-np.inf, np.inf) if forces is None else forces
        lower, upper = model.tendon_actfrcrange[tendon]
        forces = np.clip(own, lower, upper)
        if (
            np.count_nonzero(
                (model.actuator_trntype == model.actuator_trntype[i]) & (model.actuator_trnid[:, 0] == tendon)
            )
            > 1
        ):
            shares = None  # the range is that of their sum
    return {
        "name": model.actuator(i).name or f"actuator_{i}",
        "shares": shares,
        "tendons": [tendon] if model.actuator_trntype[i] == mujoco.mjtTrn.mjTRN_TENDON else [],
        "linear": bool(
            gain_terms
            and bias in (biases.mjBIAS_NONE, biases.mjBIAS_AFFINE)
            and dynamic in known
            and model.actuator_plugin[i] < 0
            and not model.actuator_delay[i]
        ),
        "dynamics": known.get(dynamic),
        "gain": [float(model.actuator_gainprm[i, k]) if k < gain_terms else 0.0 for k in range(3)],
        "bias": [float(model.actuator_biasprm[i, k]) if k < bias_terms else 0.0 for k in range(3)],
        "controls": model.actuator_ctrlrange[at].tolist() if model.actuator_ctrllimited[at] else None,
        "forces": None if forces is None else forces.tolist(),
        # Muscles and other gains act on their own if they have a bias; others may.
        "acts": bool(
            (bias != biases.mjBIAS_NONE and model.actuator_biasprm[i].any())
            or gain not in (gains.mjGAIN_FIXED, gains.mjGAIN_AFFINE, gains.mjGAIN_MUSCLE)
            or model.actuator_plugin[i] >= 0
        ),
        "ctrl": at,
        "act": int(model.actuator_actadr[i]),
    }


def _shares(model, i):
    kinds, kind, target = mujoco.mjtTrn, int(model.actuator_trntype[i]), int(model.actuator_trnid[i, 0])
    gear = _gear(model, i)
    if kind in (kinds.mjTRN_JOINT, kinds.mjTRN_JOINTINPARENT):
        found = [[target, gear]]
    elif kind == kinds.mjTRN_TENDON:
        found = [[joint, gear * share] for joint, share in _coefficients(model, target) or ()]
    else:
        return None
    return found if all(model.jnt_type[joint] in (2, 3) for joint, _ in found) else None


def _tendon(model, i):
    """Tendon: straight with `sites`, or fixed with `terms` and lengths from the pose of the file; other: more laws."""
    driver, terms = int(model.tendon_actuatorid[i]), _coefficients(model, i) or ()
    zero = float(model.tendon_length0[i]) if terms else 0.0
    return _of(model, "tendon", i, "stiffness", "damping") | {
        "name": model.tendon(i).name or f"tendon_{i}",
        "sites": _ends(model, i),
        "terms": terms,
        "rest": (model.tendon_lengthspring[i] - zero).tolist(),
        "range": (model.tendon_range[i] - zero).tolist() if model.tendon_limited[i] else None,
        "other": bool(
            model.tendon_frictionloss[i]
            or model.tendon_armature[i]
            or model.tendon_springyield[i]
            or model.tendon_stiffnesspoly[i].any()
            or model.tendon_dampingpoly[i].any()
            or (driver >= 0 and (model.actuator_armature[driver] or model.actuator_damping[driver]))
        ),
    }


def _ends(model, i):
    """Both sites of a tendon that is straight, else None."""
    part = slice(model.tendon_adr[i], model.tendon_adr[i] + model.tendon_num[i])
    if model.wrap_type[part].tolist() != [mujoco.mjtWrap.mjWRAP_SITE] * 2:
        return None
    return [_site(model, site) for site in model.wrap_objid[part]]


def _coefficients(model, i):
    """[[joint, coefficient]] of a fixed tendon; None of a spatial one."""
    part = slice(model.tendon_adr[i], model.tendon_adr[i] + model.tendon_num[i])
    if set(model.wrap_type[part].tolist()) != {int(mujoco.mjtWrap.mjWRAP_JOINT)}:
        return None
    shares = {}
    for joint, share in zip(model.wrap_objid[part].tolist(), model.wrap_prm[part].tolist()):
        shares[joint] = shares.get(joint, 0.0) + share
    return [list(each) for each in shares.items()]


def _joint(model, i):
    dof, at, kind = model.jnt_dofadr[i], model.jnt_qposadr[i], int(model.jnt_type[i])
    driver = int(model.jnt_actuatorid[i])  # the actuator whose damping and armature act at this joint
    nonlinear = np.any(model.jnt_stiffnesspoly[i]) or np.any(model.dof_dampingpoly[dof])
    damping, armature = float(model.dof_damping[dof]), float(model.dof_armature[dof])
    if driver >= 0:
        nonlinear |= np.any(model.actuator_dampingpoly[driver])
        damping += _gear(model, driver) ** 2 * float(model.actuator_damping[driver])
        armature += _gear(model, driver) ** 2 * float(model.actuator_armature[driver])
    own = _of(model, "jnt", i, "pos", "axis", "stiffness", body="bodyid", qpos="qposadr", dof="dofadr")
    return own | {
        "name": model.joint(i).name,
        "type": ("free", "ball", "slide", "hinge")[kind],
        "zero": float(model.qpos0[at]),
        "spring": float(model.qpos_spring[at]),
        "damping": damping,
        "nonlinear": bool(nonlinear or model.jnt_springyield[i]),
        "armature": armature,
        "efforts": model.jnt_actfrcrange[i].tolist() if model.jnt_actfrclimited[i] else None,
        "friction": float(model.dof_frictionloss[dof]),
        "range": model.jnt_range[i].tolist() if model.jnt_limited[i] else None,
    }


def _equality(model, i):
    kind = mujoco.mjtEq(int(model.eq_type[i])).name.removeprefix("mjEQ_").lower()
    first, second = int(model.eq_obj1id[i]), int(model.eq_obj2id[i])
    found = _of(model, "eq", i, "data", active="active0", first="obj1id", second="obj2id")
    found |= {"name": model.equality(i).name or f"{kind}_{i}", "type": kind, "tendons": []}
    if kind == "tendon":
        found["tendons"] = [first, second]  # the second is -1 if there is none
    if kind in ("connect", "weld") and model.eq_objtype[i] == mujoco.mjtObj.mjOBJ_SITE:
        found["sites"] = [_site(model, site) for site in (first, second)]
    if kind == "tendon" and second < 0 and _ends(model, first):
        found["tendon"], found["sites"] = int(first), _ends(model, first)
        # The constraint prescribes the length relative to that in the pose of the file.
        found["length"] = float(model.tendon_length0[first] + model.eq_data[i][0])
    elif kind == "tendon":
        parts = [(1.0, _coefficients(model, first))]
        if second >= 0:
            parts.append((-found["data"][1], _coefficients(model, second)))
        if all(part is not None for _, part in parts) and not (second >= 0 and any(found["data"][2:5])):
            found["terms"] = [[joint, factor * share] for factor, part in parts for joint, share in part]
    return found


def _moves_mocap(model, key):
    """Whether a keyframe moves a mocap body."""
    for body in np.flatnonzero(model.body_mocapid >= 0):
        at = model.body_mocapid[body]
        pose = *model.key_mpos[key].reshape(-1, 3)[at], *model.key_mquat[key].reshape(-1, 4)[at]
        if not np.allclose(pose, [*model.body_pos[body], *model.body_quat[body]]):
            return True
    return False


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
    return {"name": model.site(i).name, "number": int(i)} | _of(model, "site", i, "pos", "quat", body="bodyid")


def triangles_of_mesh(path, number):
    """Vertices (k, 3) in m and triangles (m, 3) of a mesh of an MJCF file, in the frame of its geom."""
    model = _model_of(path)
    return [
        getattr(model, f"mesh_{key}")[start[number] :][: count[number]]
        for key, start, count in (
            ("vert", model.mesh_vertadr, model.mesh_vertnum),
            ("face", model.mesh_faceadr, model.mesh_facenum),
        )
    ]


@functools.cache
def _model_of(path):
    return _compiled(path)[0]


def _color(model, i):
    """Red, green, blue, opacity of a geom as MuJoCo draws it, a texture by its mean; None if the file gives none."""
    own, material = model.geom_rgba[i], int(model.geom_matid[i])
    if np.any(own != DEFAULT_COLOR):
        return own.tolist()
    if material < 0:
        return None
    found = model.mat_rgba[material].astype(float)
    texture = int(model.mat_texid[material, mujoco.mjtTextureRole.mjTEXROLE_RGB])
    if texture >= 0:
        start, channels = model.tex_adr[texture], model.tex_nchannel[texture]
        count = model.tex_height[texture] * model.tex_width[texture] * channels
        found[:3] *= model.tex_data[start : start + count].reshape(-1, channels).mean(axis=0)[:3] / 255.0
    return found.tolist()


def _geom(model, i):
    kind = mujoco.mjtGeom(int(model.geom_type[i])).name.removeprefix("mjGEOM_").lower()
    has_mesh = kind in ("mesh", "sdf") and model.geom_dataid[i] >= 0
    return _of(model, "geom", i, "group", "size", "pos", "quat", body="bodyid") | {
        "name": model.geom(i).name,
        "color": _color(model, i),
        "friction": float(model.geom_friction[i, 0]),
        "type": "mesh" if has_mesh else kind,
        "asset": int(model.geom_dataid[i]) if has_mesh else -1,
        "collides": bool(
            model.geom_contype[i] or model.geom_conaffinity[i] or i in model.pair_geom1 or i in model.pair_geom2
        ),
    }
