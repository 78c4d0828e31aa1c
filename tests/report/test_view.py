"""Motions: poses from columns against the geometry they stand for, files that hold them, and what is refused."""

from __future__ import annotations

import base64
import json
import re
from pathlib import Path

import numpy as np
import pytest

from phfmu import PHDAE, Place, Scene, Shape, ShapeKind, Tension
from phfmu.cli import main
from phfmu.components.mechanical.heavy_top import heavy_top
from phfmu.components.mechanical.multibody import Mechanism, Multibody
from phfmu.declare.entries.alike import first_alike
from phfmu.declare.shape import from_data, to_data
from phfmu.network.network import Network
from phfmu.report.view.poses import chosen_rows, motion
from phfmu.results.file import open_result
from phfmu.results.shapes_file import read_shapes, shapes_file
from phfmu.target import scene

PENDULUM = """
from phfmu import Scene
from phfmu.components.mechanical.multibody import Multibody

def pendulum():
    body = Multibody("pendulum", dim=2)
    body.gravity((0.0, -9.81))
    body.bar(body.support((0.0, 0.0)), body.particle(2.0, (1.0, 0.0)))
    return Scene("pendulum", body.build(), 1.0, 0.01)
"""


def packed(page: Path, name: str) -> np.ndarray:
    """Numbers of a page, as its player reads them."""
    found = re.search(rf'"{name}":"([^"]*)"', page.read_text(encoding="utf-8"))
    assert found
    return np.frombuffer(base64.b64decode(found[1]), "<f4")


@pytest.fixture(scope="module")
def pendulum(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a pendulum and the table of its run."""
    folder = tmp_path_factory.mktemp("pendulum")
    (folder / "p.py").write_text(PENDULUM)
    assert main(["run", f"{folder / 'p.py'}:pendulum", "-o", str(folder / "run.csv"), "--quiet"]) == 0
    return folder


def test_a_plane_stands_upright_and_bars_tell_their_tension(pendulum: Path) -> None:
    table, page = open_result(pendulum / "run.csv"), pendulum / "view.html"
    assert main(["view", str(pendulum / "run.csv"), "-o", str(page)]) == 0
    x, y = table.column("q[1]"), table.column("q[2]")
    poses, ends = packed(page, "poses").reshape(len(x), 2, 7), packed(page, "ends").reshape(len(x), 1, 6)
    np.testing.assert_allclose(poses[:, 0, :3], np.column_stack([x, 0 * x, y]), atol=1e-6)
    np.testing.assert_allclose(ends[:, 0], np.column_stack([np.zeros((len(x), 3)), x, 0 * x, y]), atol=1e-6)
    tension = packed(page, "tension")
    v2 = table.column("v[1]") ** 2 + table.column("v[2]") ** 2
    mean = 0.5 * (v2[1:] + v2[:-1]) - 9.81 * 0.5 * (y[1:] + y[:-1])  # m (v^2/l - g y/l), mean of the step's ends
    np.testing.assert_allclose(tension[1:], 2.0 * mean, rtol=2e-3, atol=0.05)


def test_a_view_of_a_target_is_that_of_its_table(pendulum: Path) -> None:
    page, other = pendulum / "target.html", pendulum / "table.html"
    assert main(["view", f"{pendulum / 'p.py'}:pendulum", "-o", str(page)]) == 0
    assert main(["view", str(pendulum / "run.csv"), "-o", str(other), "--shapes", f"{pendulum / 'p.py'}:pendulum"]) == 0
    for name in ("time", "poses", "ends", "tension"):
        np.testing.assert_array_equal(packed(page, name), packed(other, name))
    text = page.read_text(encoding="utf-8")
    assert "The MIT License" in text and len(text) < 1_500_000


def test_directors_turn_a_solid() -> None:
    """A rotation about the third axis, of directors that are neither of length one nor quite orthogonal."""
    angle = np.linspace(0.0, 7.0, 40)
    unit = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    axes = tuple(Place(terms=tuple((f"d[{3 * i + j + 1}]", unit[j]) for j in range(3))) for i in range(3))
    box = Shape(ShapeKind.BOX, (Place((1.0, 2.0, 3.0)),), size=(1.0, 1.0, 1.0), axes=axes)
    c, s, o = np.cos(angle), np.sin(angle), 0 * angle
    directors = [0.2 * c, 0.2 * s, o, -3.0 * s, 3.0 * c, o, o, o, 0 * c + 0.5]
    made = motion("turn", [box], angle, {f"d[{i + 1}]": d for i, d in enumerate(directors)})
    turned = 2.0 * np.unwrap(np.arctan2(made.poses[:, 0, 5], made.poses[:, 0, 6]))
    np.testing.assert_allclose(turned, angle, atol=1e-12)
    np.testing.assert_allclose(made.poses[:, 0, :3], [[1.0, 2.0, 3.0]] * 40)


def test_shapes_keep_their_text_and_take_the_names_of_members() -> None:
    shapes = heavy_top().shapes
    assert from_data(json.loads(json.dumps(to_data(shapes)))) == shapes
    net = Network("two")
    net.add("a", heavy_top())
    net.add("b", heavy_top(spin=10.0))
    composed, apart = net.compose().shapes, Scene("two", net, 1.0, 1e-3).shapes
    assert composed == apart and len(composed) == 2 * len(shapes)
    assert composed[-1].signals()[0].startswith("b.q[") and composed[-1].label == "b.stem"


def test_shapes_make_no_other_model() -> None:
    bare = PHDAE("bare", states=heavy_top().states)
    with_shape = PHDAE("bare", states=bare.states, shapes=(Shape(ShapeKind.BALL, (Place((0.0, 0.0, 0.0)),)),))
    assert first_alike(bare) is first_alike(with_shape)


def test_rows_are_spread_over_the_time_of_uneven_steps() -> None:
    time = np.concatenate([np.linspace(0.0, 0.1, 1000), np.linspace(0.2, 1.0, 9)])
    rows = chosen_rows(time, 11)
    assert rows[0] == 0 and rows[-1] == len(time) - 1 and len(rows) == 11
    assert np.diff(time[rows]).max() < 0.15


@pytest.mark.parametrize(
    "words, said",
    [
        (["view", "dc_motor", "-o", "x.html", "--stop", "0.01"], "has no shapes to show"),
        (["view", "four_particle", "-o", "x.png"], "the ending must be .html"),
        (["view", "none.csv", "-o", "x.html"], "no file 'none.csv'"),
        (["view", "bare.csv", "-o", "x.html"], "name the target they are of: phfmu view bare.csv --shapes TARGET"),
        (
            ["view", "bare.csv", "-o", "x.html", "--shapes", "four_particle"],
            "lacks 12 columns that its shapes move with: q[1]",
        ),
        (["view", "bare.csv", "-o", "x.html", "--stop", "1"], "--stop is for a target that is run"),
        (["view", "four_particle", "-o", "x.html", "--shapes", "four_particle"], "four_particle brings its own"),
        (["run", "four_particle", "--view", "x.html", "--signals", "v*", "--quiet"], "lacks 12 columns"),
    ],
)
def test_what_cannot_be_shown_is_told(tmp_path: Path, monkeypatch, capsys, words: list[str], said: str) -> None:
    monkeypatch.chdir(tmp_path)
    Path("bare.csv").write_text("time,a\n0.0,1.0\n1.0,2.0\n")
    assert main(words) == 2
    assert said in capsys.readouterr().err and not Path("x.html").exists()


def test_a_table_of_another_run_in_its_place_takes_the_shapes_away(tmp_path: Path) -> None:
    table = tmp_path / "run.parquet"
    assert main(["run", "four_particle", "--stop", "0.1", "-o", str(table), "--quiet"]) == 0
    assert len(read_shapes(table)) == 8
    assert main(["run", "dc_motor", "--stop", "0.01", "-o", str(table), "--quiet"]) == 0
    assert not shapes_file(table).exists()


def test_a_damaged_file_of_shapes_is_told(tmp_path: Path) -> None:
    shapes_file(tmp_path / "run.csv").write_text('[{"kind": "cone"}]')
    with pytest.raises(ValueError, match=r"run\.shapes\.json does not tell of shapes: .*--shapes TARGET"):
        read_shapes(tmp_path / "run.csv")


def test_solids_of_a_system_say_what_they_need() -> None:
    body = Multibody("b")
    with pytest.raises(ValueError, match="a box a centre and three edges"):
        body.solid("box", body.particle(1.0, (0.0, 0.0, 0.0)), size=(1.0,))


def test_tension_that_the_table_lacks_is_no_colour() -> None:
    rod = Shape(ShapeKind.ROD, (Place(), Place((1.0, 0.0, 0.0))), tension=Tension("lambda", 2.0))
    time = np.array([0.0, 1.0])
    assert np.isnan(motion("m", [rod], time, {}).tension).all()
    assert motion("m", [rod], time, {"lambda": np.array([1.0, -2.0])}).tension.ravel().tolist() == [2.0, -4.0]


def test_bodies_are_boxes_of_their_inertia_that_turn() -> None:
    made = Mechanism("two")
    made.body("box", 2.0, (0.5, 0.4, 0.3), angular_velocity=(0.0, 0.0, 1.0))
    made.rod("rod", 1.0, 0.6)
    box, rod = made.build().shapes
    a, b, c = sorted(x**2 for x in box.size)
    np.testing.assert_allclose(2.0 / 12 * np.array([b + c, a + c, a + b]), (0.5, 0.4, 0.3), rtol=1e-12)
    assert rod.kind is ShapeKind.ROD and len(rod.points) == 2 and len(box.axes) == 3
    columns = {n: np.zeros(1) for n in dict.fromkeys([*box.signals(), *rod.signals()])}
    directors = [n for n in rod.signals() if dict(rod.points[0].terms)[n] != dict(rod.points[1].terms)[n]]
    moved = motion("m", [rod], np.zeros(1), columns | {directors[0]: np.array([0.6 / np.sqrt(12.0)])})
    assert np.linalg.norm(moved.ends[0, 0, 3:] - moved.ends[0, 0, :3]) == pytest.approx(0.6)


@pytest.mark.slow
def test_an_animated_image_has_its_pictures(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    from PIL import Image

    assert main(["view", "heavy_top", "--stop", "0.2", "-o", str(tmp_path / "top.gif")]) == 0
    with Image.open(tmp_path / "top.gif") as image:
        assert getattr(image, "n_frames", 1) == 50
        first = np.asarray(image.convert("RGB"), int)
        image.seek(25)
        moved = np.abs(np.asarray(image.convert("RGB"), int) - first).max(axis=2) > 40
    assert 0.005 < moved.mean() < 0.6 and (first.min(axis=2) < 200).mean() > 0.05


def test_scenes_of_the_library_have_shapes_where_bodies_move() -> None:
    assert {len(scene(name).shapes) > 0 for name in ("four_particle", "heavy_top", "chain")} == {True}
