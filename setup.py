# SPDX-License-Identifier: Apache-2.0
"""One package for pip and for colcon (ament_python)."""

from glob import glob

from setuptools import find_packages, setup

NAME = "liegroup_sim_ros"

setup(
    name=NAME,
    version="0.3.0",
    description="Multibody dynamics on Lie groups, simulated in real time, served to ROS 2 and recorded.",
    maintainer="liegroup_sim_ros developers",
    license="Apache-2.0",
    python_requires=">=3.11",
    packages=find_packages(include=["liegroup_core*", "liegroup_sim_ros*"]),
    package_data={NAME: ["py.typed"], "liegroup_core": ["py.typed"], f"{NAME}.report": ["page.css", "page.js"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/config", [path for kind in ("yaml", "rviz", "json") for path in glob(f"config/*.{kind}")]),
        (f"share/{NAME}/config/scenes", glob("config/scenes/*.yaml")),
        (f"share/{NAME}/launch", glob("launch/*.launch.*")),
        (f"lib/{NAME}", ["resource/sim_node"]),
    ],
    # ROS 2 itself is not listed: it comes from the sourced workspace or, see Makefile, as wheels.
    install_requires=[
        "google-re2",  # regular expressions of requests, in linear time
        "lxml",  # robot files, with the lines of their errors
        "mcap>=1.5",
        "mcap-ros2-support",
        "numba>=0.63",
        "numpy>=1.26",
        "plotly",
        "pydantic>=2",
        "pyyaml",
        "rich",
        "scipy>=1.11",
        "threadpoolctl",
        "zstandard",
    ],
    extras_require={
        "figures": ["matplotlib", "mpmath"],
        # Design of controllers: LinearSystem.to_control.
        "control": ["control"],
        # Bags of real machines: `liegroup_sim compare`, `identify`.
        "bags": ["rosbags"],
        # many: many recordings or runs on a cluster, and the files of `liegroup_sim sweep`. remote:
        # recordings at http(s) addresses; other kinds need their own package, such as s3fs for s3://.
        "many": ["dask", "distributed", "pyarrow"],
        "pandas": ["pandas"],
        # xacro files, and MJCF files through MuJoCo's compiler; plain URDF and SDF need neither.
        "robots": ["mujoco", "xacro"],
        # Visuals of a robot in the HTML report.
        "meshes": ["fast-simplification", "pycollada", "trimesh"],
        "remote": ["aiohttp", "fsspec"],
        # The live page; av: videos of it.
        "view": ["av", "viser>=1.1,<2"],
        "test": [
            "aiohttp",
            "av",
            "control",
            "dask",
            "distributed",
            "fast-simplification",
            "fsspec",
            "hypothesis",
            "jsonschema",
            "matplotlib",
            "mpmath",
            "mujoco",
            "pandas",
            "playwright",
            "pyarrow",
            "pybag-sdk",
            "pytest",
            "pytest-xdist",
            "rosbags",
            "small-mcap",
            "trimesh",
            "urdf-parser-py",
            "viser>=1.1,<2",
            "xacro",
            "yourdfpy",
        ],
        "lint": ["mypy", "ruff"],
        "docs": ["mkdocs-material", "mkdocstrings-python"],
        # Peers of benchmarks/; cmeel-eigen has the Eigen headers to compile the Pinocchio loop.
        # Robots of benchmarks/robots.py: example-robot-data, dm-control.
        "bench": ["cmeel-eigen", "dm-control", "example-robot-data", "exudyn", "mujoco", "pin"],
    },
    entry_points={
        "console_scripts": [
            "liegroup_sim = liegroup_sim_ros.commands.main:main",
            "sim_node = liegroup_sim_ros.node.entry:main",
        ],
        # Methods of Simulation that packages above it carry out: liegroup_core/parts.py.
        "liegroup_core.attached": [
            "sensitivities = liegroup_core.linear:sensitivities",
            "view = liegroup_sim_ros.notebook:live",
        ],
    },
)
