"""Packages that only pictures need."""

from importlib.util import find_spec


def require(package: str) -> None:
    """Raise ValueError unless the package is installed."""
    if find_spec(package) is None:
        what = {"matplotlib": "a PNG", "plotly": "an HTML page", "networkx": "a page of a large network"}[package]
        raise ValueError(f'{what} needs {package}, which is not installed: pip install "phfmu[report]"')
