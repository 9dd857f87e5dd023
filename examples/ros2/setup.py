"""Installs the node, as `colcon build` asks for."""

from setuptools import setup

NAME = "carpark_mj_ros"

setup(
    name=NAME,
    version="0.1.0",
    packages=[NAME],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
    ],
    install_requires=["setuptools"],
    entry_points={"console_scripts": [f"lot = {NAME}.node:main"]},
)
