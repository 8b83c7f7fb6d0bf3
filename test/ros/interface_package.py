# SPDX-License-Identifier: Apache-2.0
"""Build a package of ROS interfaces from definitions, as colcon does, by the generators of rosidl.

The wheels of rclpy bring the generators. One shared library has all of C, a second one is the name
by which rmw finds the type support of introspection in it, the third is the module of Python. That
loads the other two, so that no search path is needed.
"""

import hashlib
import importlib.util
import json
import os
import shutil
import subprocess
import sys
import sysconfig
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

DEPENDENCIES = (
    "builtin_interfaces",
    "unique_identifier_msgs",
    "service_msgs",
    "std_msgs",
    "geometry_msgs",
    "action_msgs",
)
KINDS = {"fastrtps": "rosidl_typesupport_fastrtps_c", "introspection": "rosidl_typesupport_introspection_c"}
RUNTIME = ("rosidl_runtime_c", "rosidl_typesupport_c", "fastcdr", "rcutils", "rmw")


def missing():
    """What a build needs and this machine lacks, or ""."""
    header = Path(sysconfig.get_paths()["include"]) / "Python.h"
    if not (shutil.which("gcc") and shutil.which("g++") and header.is_file()):
        return "a compiler with Python.h"
    return "" if importlib.util.find_spec("rosidl_generator_py") else "rosidl_generator_py"


def built(package, definitions, cache):
    """Folder in which Python finds the package.

    definitions : {"msg/Name": text}, also srv/ and action/
    cache       : folder that keeps builds; a build takes about 20 s
    """
    text = json.dumps([package, definitions, sys.version, Path(__file__).read_text()])
    folder = cache / hashlib.sha256(text.encode()).hexdigest()[:16]
    if not (folder / package).is_dir():
        work = folder.with_suffix(f".{os.getpid()}")
        shutil.rmtree(work, ignore_errors=True)
        _build(package, definitions, work, work / "python" / package)
        folder.mkdir(exist_ok=True)
        (work / "python" / package).rename(folder / package)
        (work / "hashes.json").rename(folder / "hashes.json")
        shutil.rmtree(work)
    return folder


def hashes(folder):
    """{"msg/Name": type hash (REP 2011)} of a package that `built` returned."""
    return json.loads((folder / "hashes.json").read_text())


def _prefix():
    """Folder with share/, include/ and lib/ of the packages."""
    paths = [*os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep), sys.prefix]
    return next(Path(path) for path in paths if (Path(path) / "share/rosidl_generator_c").is_dir())


def _build(package, definitions, work, python):
    from rosidl_adapter import convert_to_idl

    prefix, idl = _prefix(), work / "idl" / package
    for name, text in definitions.items():
        path = work / package / f"{name}.{name.partition('/')[0]}"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
        file = path.relative_to(work / package)
        convert_to_idl(work / package, package, file, idl)
    sources = _generate(package, definitions, work, idl, python, prefix / "share")
    found = {}
    for name in definitions:
        types = json.loads((idl / f"{name}.json").read_text())["type_hashes"]
        full = f"{package}/{name}"
        found[name] = next(t["hash_string"] for t in types if t["type_name"] == full)
    (work / "hashes.json").write_text(json.dumps(found))
    _compile(package, sources, work, python, prefix)


def _generate(package, definitions, work, idl, python, share):
    """Write all sources; returns the folders with those of C. A generator a folder: names repeat."""
    from rosidl_generator_c import generate_c
    from rosidl_generator_py import generate_py
    from rosidl_generator_type_description import generate_type_hash
    from rosidl_typesupport_c import generate_c as generate_dispatch
    from rosidl_typesupport_fastrtps_c import generate_typesupport_fastrtps_c
    from rosidl_typesupport_introspection_c import generate_c as generate_introspection

    names = [f"{name}.idl" for name in definitions]
    common = {
        "package_name": package,
        "idl_tuples": [f"{idl}:{name}" for name in names],
        "ros_interface_dependencies": [
            f"{name}:{path}" for name in DEPENDENCIES for path in (share / name).rglob("*.idl")
        ],
        "target_dependencies": [],
    }

    def run(generate, generator, output, *rest, **more):
        resource = share / generator / "resource"
        path = work / "arguments.json"
        settings = {"template_dir": str(resource), "output_dir": str(output), **more}
        path.write_text(json.dumps(common | settings))
        generate(str(path), *rest)
        for template in resource.glob("*__visibility_control.h.in"):
            text = template.read_text().replace("@PROJECT_NAME@", package)
            text = text.replace("@PROJECT_NAME_UPPER@", package.upper())
            (output / "msg" / template.stem).write_text(text)

    run(
        generate_type_hash,
        "rosidl_generator_type_description",
        idl,
        include_paths=[f"{name}:{share / name}" for name in DEPENDENCIES],
    )
    folders = {name: work / name / package for name in ("rosidl_generator_c", "dispatch", *KINDS.values())}
    run(
        generate_c,
        "rosidl_generator_c",
        folders["rosidl_generator_c"],
        type_description_tuples=[f"{name}:{(idl / name).with_suffix('.json')}" for name in names],
        ros_interface_files=[str(path) for path in sorted((work / package).rglob("*.*"))],
    )
    for generate, kind in (
        (generate_typesupport_fastrtps_c, KINDS["fastrtps"]),
        (generate_introspection, KINDS["introspection"]),
    ):
        run(generate, kind, folders[kind])
    run(generate_dispatch, "rosidl_typesupport_c", folders["dispatch"], list(KINDS.values()))
    run(generate_py, "rosidl_generator_py", python, ["rosidl_typesupport_c"])
    (python / "__init__.py").touch()
    return [*(folder.parent for folder in folders.values()), python]


def _compile(package, sources, work, python, prefix):
    """Compile the sources in some folders, the last one that of Python, and link the libraries."""
    folders = [*sources[:-1], Path(sysconfig.get_paths()["include"]), Path(np.get_include())]
    folders += [prefix / "include", *sorted((prefix / "include").iterdir())]
    options = [f"-I{folder}" for folder in folders if folder.is_dir()]
    # The C++ files name nothing twice; together they take a tenth of the time.
    together, nothing = work / "all.cpp", work / "nothing.c"
    together.write_text("".join(f'#include "{path}"\n' for folder in sources for path in sorted(folder.rglob("*.cpp"))))
    nothing.touch()
    own = [together, *(path for folder in sources[:-1] for path in sorted(folder.rglob("*.c")))]
    files = [*own, nothing, *sorted(python.rglob("*.c"))]

    def run(*command):
        done = subprocess.run([str(part) for part in command], capture_output=True, text=True)
        assert done.returncode == 0, done.stderr[-3000:]

    def compiled(k, path):
        target = work / f"{k}.o"
        compiler = "g++" if path.suffix == ".cpp" else "gcc"
        run(compiler, "-O0", "-fPIC", "-w", "-c", path, "-o", target, *options)
        return target

    with ThreadPoolExecutor(2) as pool:
        objects = list(pool.map(compiled, range(len(files)), files))
    parts = ("rosidl_generator_c", "rosidl_generator_py", "rosidl_typesupport_c", *KINDS.values())
    libraries = [f"-l{name}__{part}" for name in DEPENDENCIES for part in parts]
    libraries += [f"-l{name}" for name in (*RUNTIME, *KINDS.values())]
    where = [f"-L{prefix / 'lib'}", f"-Wl,-rpath,{prefix / 'lib'}:$ORIGIN", "-Wl,--no-as-needed"]
    all_of_c, by_name = (python / f"lib{package}__{kind}.so" for kind in KINDS.values())
    module = python / f"{package}_s__rosidl_typesupport_c.so"
    k = len(own)
    for library, contents in (
        (all_of_c, objects[:k]),
        (by_name, [objects[k], all_of_c]),
        (module, [*objects[k + 1 :], all_of_c, by_name]),
    ):
        name = f"-Wl,-soname,{library.name}"
        run("g++", "-shared", "-o", library, name, *where, *contents, *libraries)
