"""The portable unit of the four particles: in a C host beside the native engine, and through FMPy beside PythonFMU's.

PythonFMU runs a slave written in Python inside the unit; here it does one classical Runge-Kutta step of the equations with
lambda eliminated (NumPy), the least an author could write.
"""

from __future__ import annotations

import resource
import subprocess
import sys
import tempfile
import textwrap
import time
import zipfile
from pathlib import Path

from common import Run

from phfmu.components.mechanical.four_particle import four_particle
from phfmu.discretise.model import build_model, default_scheme
from phfmu.fmu.export.export import export
from phfmu.fmu.export.sources import HEADERS
from phfmu.fmu.importer.reader import FMUInstance

HOST = Path(__file__).parents[1] / "fmu" / "fmu_host.c"
STEPS, H = 300_000, 0.0143

SLAVE = """
    import numpy as np
    from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Real

    MASS = np.repeat([1.0, 3.0, 2.3, 1.7], 3)

    def rate(y):
        q, v = y[:12].reshape(4, 3), y[12:].reshape(4, 3)
        force = np.zeros((4, 3))
        for k, i, j in ((50.0, 0, 2), (500.0, 1, 3)):
            d = q[j] - q[i]
            pull = 2.0 * k * (d @ d - 1.0) * d
            force[i] += pull
            force[j] -= pull
        d = q[2] - q[1]
        drag = (1.0 + 0.5 * (d @ d)) * (v[2] - v[1])
        force[1] += drag
        force[2] -= drag
        rows = np.zeros((2, 4, 3))
        turning = np.zeros(2)
        for r, (i, j) in enumerate(((0, 1), (2, 3))):
            rows[r, j] = q[j] - q[i]
            rows[r, i] = -rows[r, j]
            turning[r] = (v[j] - v[i]) @ (v[j] - v[i])
        rows, force = rows.reshape(2, 12), force.ravel()
        lam = np.linalg.solve((rows / MASS) @ rows.T, rows @ (force / MASS) + turning)
        return np.concatenate([y[12:], (force - rows.T @ lam) / MASS])

    class FourParticles(Fmi2Slave):
        def __init__(self, **kwargs):
            super().__init__(**kwargs)
            self.y = np.zeros(24)
            self.y[[3, 7, 9, 10]] = 1.0
            self.y[23] = 20.0 / 17.0
            self.q12 = 0.0
            self.register_variable(Real("q12", causality=Fmi2Causality.output))

        def do_step(self, time, h):
            a = rate(self.y)
            b = rate(self.y + 0.5 * h * a)
            c = rate(self.y + 0.5 * h * b)
            d = rate(self.y + h * c)
            self.y = self.y + h / 6.0 * (a + 2.0 * b + 2.0 * c + d)
            self.q12 = float(self.y[11])
            return True
"""


def in_a_host(unit: Path, folder: Path, token: str, run: Run) -> None:
    """CPU time of a step in the host (start-up taken off) and in the native engine."""
    with zipfile.ZipFile(unit) as archive:
        name = next(n for n in archive.namelist() if n.endswith((".so", ".dylib")))
        (folder / "unit.so").write_bytes(archive.read(name))
    host = folder / "host"
    subprocess.run(["cc", "-std=c11", "-O2", "-isystem", str(HEADERS), str(HOST), "-o", str(host), "-ldl"], check=True)

    def spent(n: int) -> float:
        before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
        subprocess.run([host, folder / "unit.so", "2.0", token, repr(H), str(n), "-1", "0", "1"], check=True, stdout=-3)
        return resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before

    pairs = []
    for _ in range(7):
        start = time.process_time()
        run.instance.reset()
        run.instance.run(0.0, H, STEPS)
        native = time.process_time() - start
        pairs.append((spent(STEPS) - spent(1), native))
    unit_time, native = (sorted(values)[len(pairs) // 2] for values in zip(*pairs, strict=True))
    print(
        f"a step: unit in a C host {1e6 * unit_time / STEPS:.2f} us, native engine {1e6 * native / STEPS:.2f} us, "
        f"ratio {unit_time / native:.2f} (asked 2)"
    )


def through_fmpy(unit: Path, steps: int) -> float:
    """Seconds of CPU time a step through FMPy."""
    with FMUInstance(unit) as instance:
        for k in range(20):
            instance.do_step(k * H, H)
        start = time.process_time()
        for k in range(20, steps):
            instance.do_step(k * H, H)
        return (time.process_time() - start) / (steps - 20)


def main() -> None:
    declaration = four_particle()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        model = build_model(declaration, default_scheme(declaration, 6))
        unit = export(model, folder, step=H, stop=10.0, versions=("2.0",))[0]
        with FMUInstance(unit) as instance:
            token = instance.interface.token
        in_a_host(unit, folder, token, Run(declaration, 6, H))
        script = folder / "four_particles.py"
        script.write_text(textwrap.dedent(SLAVE))
        command = [sys.executable, "-m", "pythonfmu", "build", "-f", str(script), "-d", str(folder)]
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode:
            print(f"PythonFMU is not installed or did not build the unit: {done.stderr.strip()[-200:]}")
            return
        ours, other = through_fmpy(unit, 20_000), through_fmpy(folder / "FourParticles.fmu", 2_000)
        print(
            f"through FMPy a step: {1e6 * ours:.1f} us, PythonFMU {1e6 * other:.0f} us, ratio {other / ours:.0f} (asked 20)"
        )


if __name__ == "__main__":
    main()
