"""Regenerate the reference CSV files: python tests/reference/make.py [scene ...]  (no scene: all of them).

Scenes: smib, smib_hydro, two_machine, two_machine_early, four_particle, drive.
Every scene is computed twice or more; the agreement is printed and stands in the first line of its file.
"""

import argparse
import time

import drive_reference
import four_particle_reference
import smib_reference
import two_machine_reference

SCENES = {
    "smib": smib_reference,
    "smib_hydro": smib_reference,
    "two_machine": two_machine_reference,
    "two_machine_early": two_machine_reference,
    "four_particle": four_particle_reference,
    "drive": drive_reference,
}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", nargs="*", help="scene names; none means all")
    options = parser.parse_args()
    unknown = [name for name in options.scene if name not in SCENES]
    if unknown:
        parser.error(f"unknown scene {unknown}; known: {list(SCENES)}")
    for name in options.scene or SCENES:
        begin = time.perf_counter()
        path, errors = SCENES[name].make(name)
        print(f"{path.name}  ({time.perf_counter() - begin:.1f} s)")
        for group, value in errors.items():
            print(f"    {group}: {value:.1e}")


if __name__ == "__main__":
    main()
