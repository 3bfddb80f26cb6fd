# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Read by catkin, and by pip, which makes a wheel for a Python that has ROS already."""

import shutil
from pathlib import Path

from catkin_pkg.python_setup import generate_distutils_setup
from setuptools import find_packages, setup

ROOT = Path(__file__).resolve().parent
SHARE = "share/cassandra_ros"
SHARED_FOLDERS = ("config", "examples", "launch", "msg", "requirements", "srv")
SHARED_FILES = ("LICENSE", "package.xml")
NAME = "cassandra_ros"
PACKAGE_DATA = [
    "py.typed",
    "local_server/*.java",
    "local_server/*.txt",
    "local_server/*.xml",
    "local_server/*.yaml",
    "query/tree/*.json",
    "query/tree/*.lark",
    "viewing/web/*.css",
    "viewing/web/*.html",
    "viewing/web/*.svg",
    "viewing/web/modules/*.js",
]


def pins(name):
    """Return the pins of a file of requirements/, without those of the files that it includes."""
    text = (ROOT / "requirements" / f"{name}.txt").read_text(encoding="utf-8")
    lines = (line.strip() for line in text.splitlines())
    return [line for line in lines if line and not line.startswith(("#", "-r"))]


def generate_messages(folder):
    """Write the Python modules of msg/ and srv/, as catkin's build does."""
    try:
        from genpy.generator import MsgGenerator, SrvGenerator
        from rospkg import RosPack
    except ImportError as exc:
        raise SystemExit(
            f"{exc}: the wheel is built with genpy and rospkg of ROS; run pip in a Python that has "
            "them, with --no-build-isolation"
        ) from exc
    from genpy.generate_initpy import write_modules

    packages = RosPack()
    found = {name: [f"{packages.get_path(name)}/msg"] for name in ("geometry_msgs", "std_msgs")}
    found[NAME] = [str(ROOT / "msg")]
    for kind, generator in (("msg", MsgGenerator()), ("srv", SrvGenerator())):
        files = sorted(map(str, (ROOT / kind).glob(f"*.{kind}")))
        (folder / kind).mkdir(parents=True)
        if generator.generate_messages(NAME, files, str(folder / kind), found):
            raise SystemExit(f"the modules of {kind}/ could not be generated: the reason is above")
        write_modules(str(folder / kind))


def wheel_command():
    """Return the command that adds to a wheel what catkin generates and installs itself."""
    try:
        from setuptools.command.bdist_wheel import bdist_wheel  # setuptools 70.1 and later
    except ImportError:
        from wheel.bdist_wheel import bdist_wheel

    class Wheel(bdist_wheel):
        def run(self):
            made = ROOT / "build" / "wheel"
            # No modules that are gone since, and no second executable for rosrun to find.
            self.remove_built()
            try:
                self.add_generated(made)
                super().run()
            finally:
                self.remove_built()

        @staticmethod
        def remove_built():
            for pattern in ("wheel", "lib", "scripts-*"):
                for old in (ROOT / "build").glob(pattern):
                    shutil.rmtree(old)

        def add_generated(self, made):
            generate_messages(made / NAME)
            for kind in ("msg", "srv"):
                self.distribution.packages.append(f"{NAME}.{kind}")
                self.distribution.package_dir[f"{NAME}.{kind}"] = f"build/wheel/{NAME}/{kind}"
            # rosrun and roslaunch look for executable files beside package.xml.
            shutil.copytree(ROOT / "scripts", made / "scripts")
            files = [ROOT / name for name in SHARED_FILES]
            folders = {SHARE: files, f"{SHARE}/scripts": list((made / "scripts").iterdir())}
            for path in folders[f"{SHARE}/scripts"]:
                path.chmod(0o755)
            for name in SHARED_FOLDERS:
                for path in sorted((ROOT / name).rglob("*")):
                    if path.is_file() and path.suffix not in (".pyc", ".sh"):
                        folder = path.parent.relative_to(ROOT).as_posix()
                        folders.setdefault(f"{SHARE}/{folder}", []).append(path)
            self.distribution.data_files = [
                (folder, [path.relative_to(ROOT).as_posix() for path in paths])
                for folder, paths in folders.items()
            ]
            scripts = sorted((ROOT / "scripts").iterdir())
            self.distribution.scripts = [f"scripts/{path.name}" for path in scripts]

    return Wheel


def own_arguments():
    """Return what only pip asks for; catkin's build may lack the wheel package."""
    try:
        commands = {"bdist_wheel": wheel_command()}
    except ImportError:
        commands = {}
    extras = ("java", "spark", "tables", "viewer")
    return {
        "cmdclass": commands,
        "install_requires": pins("runtime"),
        "extras_require": {name: pins(name) for name in extras},
        "python_requires": ">=3.8",
    }


setup(
    **generate_distutils_setup(
        packages=find_packages("src"),
        package_dir={"": "src"},
        package_data={NAME: PACKAGE_DATA},
        **own_arguments(),
    )
)
