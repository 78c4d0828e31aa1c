"""Where the packages are; all else stands in pyproject.toml.

Declarations live in the top-level folder components/ and are imported as phfmu.components, never as `components`.  The link
phfmu/components makes the checkout importable as it is, so that an editable install is a plain path: editors and type
checkers follow paths, not import hooks.  A checkout without links (Windows) maps the folder instead.
"""

from pathlib import Path

from setuptools import setup

linked = (Path(__file__).parent / "phfmu" / "components").is_dir()
setup(package_dir={"": "."} if linked else {"phfmu.components": "components"})
