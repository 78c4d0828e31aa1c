"""Units that other projects publish: a folder of them is named by PHFMU_PUBLIC_UNITS, else beside the reference data.

`quarter_truck`: Chassis.fmu and Wheel.fmu of libcosim's test data (MIT).  `reference_fmus`: 2.0 and 3.0, the Reference FMUs of
the Modelica Association (BSD 2-clause).
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

FOLDER = Path(os.environ.get("PHFMU_PUBLIC_UNITS") or Path(__file__).parent.parent / "reference" / "data" / "units")


def public(*names: str) -> Path:
    """The path of the first; the test is skipped where one is not there, or units of this folder are for another machine."""
    missing = [n for n in names if not (FOLDER / n).is_file()]
    if missing:
        pytest.skip(f"{missing[0]} is not in {FOLDER} (PHFMU_PUBLIC_UNITS names another folder)")
    if sys.platform != "linux":
        pytest.skip("their libraries are for Linux")
    return FOLDER / names[0]
