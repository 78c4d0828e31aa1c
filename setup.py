"""Where the packages are, and the runtime in wheels; all else stands in pyproject.toml.

Declarations live in the top-level folder components/ and are imported as phfmu.components, never as `components`.  The link
phfmu/components makes the checkout importable as it is, so that an editable install is a plain path: editors and type
checkers follow paths, not import hooks.  A checkout without links (Windows) maps the folder instead.

A wheel holds the libraries that all models have in common, compiled for its platform, so that models run where there is no
compiler.  It is of one platform then, and of no version of Python.  Without ziglang it is built without them, for all platforms.
"""

import importlib.util
import sys
from pathlib import Path

from setuptools import setup
from setuptools.command.bdist_wheel import bdist_wheel
from setuptools.command.build_py import build_py
from setuptools.dist import Distribution

HERE = Path(__file__).parent
SHIPS = importlib.util.find_spec("ziglang") is not None


class BuildPackage(build_py):
    """The package, with its compiled libraries."""

    def run(self):
        super().run()
        if SHIPS and not self.editable_mode:
            sys.path.insert(0, str(HERE))
            from phfmu.engine.build.compile import SHIPPED, ship
            from phfmu.engine.build.runtime_sources import LIBRARIES

            ship(Path(self.build_lib) / SHIPPED.relative_to(HERE), [sources() for sources in LIBRARIES.values()])


class BuildWheel(bdist_wheel):
    """A wheel whose libraries are of a platform, not of a version of Python; on Linux they need glibc 2.17."""

    def get_tag(self):
        python, abi, platform = super().get_tag()
        return ("py3", "none", platform.replace("linux_", "manylinux_2_17_", 1)) if SHIPS else (python, abi, platform)


class Package(Distribution):
    """Has libraries of a platform if it ships them."""

    def has_ext_modules(self):
        return SHIPS


linked = (HERE / "phfmu" / "components").is_dir()
setup(
    package_dir={"": "."} if linked else {"phfmu.components": "components"},
    distclass=Package,
    cmdclass={"build_py": BuildPackage, "bdist_wheel": BuildWheel},
)
