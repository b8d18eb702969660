"""Installs the package as colcon expects it of the build type ament_python."""

from setuptools import setup

NAME = "siamloc_ros"

setup(
    name=NAME,
    version="0.2.0",
    description="Locates a mobile robot by the images of its camera, with a bundle of siamloc.",
    author="the siamloc authors",
    license="MIT",
    packages=[NAME],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/config", ["config/localizer.yaml"]),
        (f"share/{NAME}/launch", ["launch/localizer.launch.py"]),
    ],
    install_requires=["setuptools"],
    zip_safe=True,
    entry_points={"console_scripts": [f"localizer = {NAME}.node:main"]},
)
