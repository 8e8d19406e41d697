# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Install the package by pip or by colcon.

The version stands here, in package.xml, CHANGELOG.rst and ``soft_throw_ros.__version__``; a test
compares them. The metadata is here and not in pyproject.toml, because
``colcon build --symlink-install`` hands setuptools this file and setup.cfg only.

"""

from pathlib import Path
import runpy
import sys

from setuptools import find_packages, setup

NAME = 'soft_throw_ros'
EXECUTABLES = runpy.run_path(f'{NAME}/__main__.py')['EXECUTABLES']

# colcon (and a ROS build farm) runs `setup.py install` or `develop`, pip never does.
if {'install', 'develop'}.intersection(sys.argv):
    scripts = [f'{name} = {NAME}.__main__:run_{name}' for name in EXECUTABLES]
else:
    scripts = [f'soft-throw = {NAME}.__main__:main']

setup(
    name=NAME,
    version='0.2.0',
    description='A digital twin of a soft-layer throwing rig, as ROS 2 nodes',
    author='soft_throw_ros developers',
    author_email='soft-throw-ros@example.org',
    maintainer='soft_throw_ros developers',
    maintainer_email='soft-throw-ros@example.org',
    license='Apache-2.0',
    packages=find_packages(include=[f'{NAME}*']),
    # soft_throw_ros/config is a link to config: the code reads it there however it is installed.
    package_data={NAME: ['config/*.*']},
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{NAME}']),
        (f'share/{NAME}', ['package.xml']),
        *(
            (f'share/{NAME}/{folder}', sorted(map(str, Path(folder).glob('*.*'))))
            for folder in ('config', 'launch', 'rviz', 'urdf')
        ),
    ],
    entry_points={'console_scripts': scripts},
    python_requires='>=3.10',
    # ROS is not named: a ROS machine brings its own, and requirements/ has it from PyPI.
    install_requires=[
        'mcap>=1.6',
        'mcap-ros2-support>=0.5',
        'numba',
        'numpy',
        'pyyaml',
        'scipy',
    ],
    extras_require={
        'dask': ['distributed'],
        # Its interface changes with every minor version; this one has no wheel for Python 3.10.
        'rerun': ['matplotlib', 'rerun-sdk>=0.41,<0.42; python_version >= "3.11"'],
        'plot': ['matplotlib'],
        'video': ['av', 'imageio', 'tifffile', 'trackpy>=0.6.4'],
        'test': [
            'av',
            'colcon-common-extensions',
            'distributed',
            'flake8',  # with all that ament adds to it
            'flake8-blind-except',
            'flake8-builtins',
            'flake8-class-newline',
            'flake8-comprehensions',
            'flake8-deprecated',
            'flake8-docstrings',
            'flake8-import-order',
            'flake8-quotes',
            'hypothesis',
            'imageio',
            'import-linter>=2.1',
            'mpmath',
            'netCDF4',
            'mypy==2.4.1',  # these two have opinions that change with the version
            'ruff==0.17.5',
            'pip>=22.3',
            'pytest>=7.4',
            'pytest-timeout',
            'pytest-xdist',
            'rosbags',
            'setuptools>=70.1,<80',  # older ones need wheel, and colcon fails with newer ones
            'tifffile',
            'trackpy>=0.6.4',
            'types-PyYAML',
            'urdf-parser-py',
            'xarray',
        ],
    },
)
