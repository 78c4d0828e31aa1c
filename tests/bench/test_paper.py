"""The statements of the paper's section 6.3.3, each with its number."""

from __future__ import annotations

import pytest

from phfmu.cli import FINE, main
from phfmu.components.mechanical.four_particle import four_particle
from phfmu.studies.bench.paper import convergence, four_particle_models, statements


@pytest.fixture(scope="module")
def models():
    return four_particle_models(four_particle())


def test_convergence_table_of_the_paper(models) -> None:
    """Relative errors at t = 0.1 s against DG with h = 1e-4, as published with the paper's data."""
    published = {
        "q4": [3.4107e-5, 8.6659e-6, 1.3900e-6, 3.4512e-7],
        "v4": [2.3783e-4, 5.2660e-5, 8.1020e-6, 1.9994e-6],
        "lambda1": [5.3984e-2, 2.7000e-2, 1.0625e-2, 5.0632e-3],
    }
    table = convergence(models)
    for quantity, values in published.items():
        assert table["DG"][quantity] == pytest.approx(values, rel=5e-4)
    assert table["MP"]["q4"] == pytest.approx([3.0921e-5, 7.8002e-6, 1.2484e-6, 3.0959e-7], rel=5e-4)


@pytest.mark.slow
def test_statements(models) -> None:
    """All statements hold but one: at h = 0.4 the steps do have solutions, which a safeguarded Newton method finds."""
    for s in statements(models):
        print(f"{s.text}: {s.number:.6g}")
        assert s.holds or s.text == "both methods fail at h = 0.4"


@pytest.mark.slow
def test_bench_writes_every_figure(tmp_path, capsys) -> None:
    pytest.importorskip("matplotlib")
    assert main(["bench", "four_particle", "--paper", "-o", str(tmp_path)]) == FINE
    assert {p.name for p in tmp_path.iterdir()} >= {f"figure_{i}.png" for i in (3, 4, 5, 6)} | {"table_1.csv"}
    assert "second order in q4" in capsys.readouterr().out
