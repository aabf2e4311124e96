"""Builds sal_height, for pip and for colcon (ament_python)."""

import re
import sys
from pathlib import Path

from setuptools import find_packages, setup

version = re.search(r'__version__ = "(.+)"', Path("sal_height/__init__.py").read_text(encoding="utf-8"))[1]
estimators = Path("sal_height/elevation/estimators/registry.py").read_text(encoding="utf-8")
height_nodes = re.findall(r'\bnode="(\w+)"', estimators)

processing_nodes = sorted(
    name
    for module in Path("sal_height/engine").glob("*.py")
    for name in re.findall(r'^    usual_name = "(\w+)"', module.read_text(encoding="utf-8"), re.MULTILINE)
)

programs = (
    *("live_host", "paced_player", "player", "recorder", "simulator"),
    *height_nodes,
    *processing_nodes,
)
# colcon, which runs one of these commands, installs programs into lib/sal_height (setup.cfg), under the names that
# `ros2 run sal_height` and launch files use. pip puts them beside all others, where such names are too common.
prefix = "" if {"develop", "install"} & set(sys.argv) else "sal-height-"

SHARED = ("config", "launch")

setup(
    name="sal_height",
    version=version,
    description="Height images with uncertainty from airborne synthetic-aperture lidar and multi-beam radar",
    long_description=Path("README.md").read_text(encoding="utf-8"),
    long_description_content_type="text/markdown",
    keywords=["SAR", "synthetic-aperture lidar", "monopulse", "height", "InSAR", "ROS 2", "MCAP"],
    classifiers=[
        "Development Status :: 4 - Beta",
        "Intended Audience :: Science/Research",
        "Operating System :: POSIX :: Linux",
        *(f"Programming Language :: Python :: 3.{minor}" for minor in (11, 12, 13)),
        "Topic :: Scientific/Engineering :: GIS",
    ],
    license="Apache-2.0",
    python_requires=">=3.11,<3.14",
    packages=find_packages(include=["sal_height", "sal_height.*"]),
    package_data={
        "sal_height": [
            "presets/*.yaml",
            "presets/*.csv",
            "config/*",
            "launch/*",
            "kernel_types.txt",
            "messages/*.json",
            "messages/*.pyi",
            "py.typed",
        ]
    },
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/sal_height"]),
        ("share/sal_height", ["package.xml"]),
        # Where `ros2 launch` and $(find-pkg-share sal_height) look.
        *((f"share/sal_height/{name}", sorted(map(str, Path("sal_height", name).iterdir()))) for name in SHARED),
    ],
    # What the core and bags need, and commands that work without ROS. Nodes need the extra ros, and sal_height_msgs,
    # which is not on PyPI: pip install ./msg_defs. colcon takes both from package.xml.
    install_requires=[
        "annotated-types",
        "cyclopts",
        "cycler",
        "finufft",
        "isal",
        "lz4",
        "matplotlib",
        "mcap",
        "numba",
        "numpy",
        "pillow",
        "pydantic",
        "pyproj",
        "pyyaml",
        "rich",
        "rosbags",
        "scipy>=1.16",
        "threadpoolctl>=3.8",
        "tqdm",
        "zstandard",
    ],
    extras_require={
        "batch": ["dask", "distributed", "pyarrow"],
        "dem": ["rasterio"],
        "docs": ["mermaidx", "mkdocs", "mkdocs-material", "mkdocstrings-python"],
        "formats": ["h5netcdf", "h5py", "laspy[lazrs]", "rasterio", "sarkit", "xarray", "zarr"],
        "notebooks": ["ipykernel", "jupytext", "nbconvert"],
        "ros": ["ros-jazzy-common-interfaces", "ros-jazzy-rclpy[fastrtps]"],
        "view": ["rerun-sdk"],
        "test": ["cyclonedds; platform_machine == 'x86_64'", "h5py", "pytest", "pytest-xdist", "rio-cogeo"],
        "dev": ["colcon-common-extensions", "mypy", "pre-commit", "ruff", "types-PyYAML"],
    },
    entry_points={
        "pytest11": ["sal_height = sal_height.pytest_plugin"],
        "console_scripts": [
            "sal-height = sal_height.commands:main",
            *(f"{prefix}{program} = sal_height.nodes.scripts:main" for program in programs),
        ],
    },
)
