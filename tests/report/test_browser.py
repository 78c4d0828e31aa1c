"""The page of a run in a browser: Chromium draws it whole, from the file alone, and its scripts do not complain."""

from __future__ import annotations

import json
import struct
import subprocess
import sys
import zlib
from pathlib import Path

import pytest

from phfmu.cli import main

pytestmark = pytest.mark.slow


def opened(page: Path, fragment: str = "") -> tuple[dict, Path]:
    """What the browser found, and the picture it took, of a page and what comes after `#` in its address."""
    reason = 'no browser: pip install -e ".[browser]"'
    pytest.importorskip("PySide6.QtWebEngineWidgets", reason=reason, exc_type=ImportError)
    picture = page.with_suffix(".png")
    call = [sys.executable, str(Path(__file__).with_name("browser.py")), str(page), str(picture), fragment]
    done = subprocess.run(call, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr[-2000:]
    return json.loads(done.stdout.splitlines()[-1]), picture


def colours(picture: Path) -> set[bytes]:
    """The colours of a PNG of 8 bits a channel, each row as it is stored unfiltered."""
    data, at, packed, width, channels = picture.read_bytes(), 8, b"", 0, 4
    while at < len(data):
        (size,), kind = struct.unpack(">I", data[at : at + 4]), data[at + 4 : at + 8]
        if kind == b"IHDR":
            width, _, _, colour = struct.unpack(">IIBB", data[at + 8 : at + 18])
            channels = {2: 3, 6: 4}[colour]
        packed += data[at + 8 : at + 8 + size] if kind == b"IDAT" else b""
        at += size + 12
    rows, stride = zlib.decompress(packed), width * channels + 1
    return {rows[i : i + stride] for i in range(0, len(rows), stride)}


def test_page_of_a_run(compiler: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert (
        main(["run", "two_machine", "--stop", "0.2", "-o", "f.parquet", "--audit", "f.audit.parquet", "--quiet"]) == 0
    )
    assert main(["report", "f.audit.parquet", "f.parquet", "-o", "f.html"]) == 0
    found, picture = opened(tmp_path / "f.html")
    assert found["complaints"] == [] and found["asked"] == []
    assert found["title"].startswith("two_machine") and "Ledger closed" in found["text"]
    assert found["drawings"] > 3 and found["curves"] > 20
    assert 0 < found["right"] <= 1300, "the one-line diagram does not fit the page"
    assert len(colours(picture)) > 200, "hardly anything is drawn"


def test_picture_of_a_run(compiler: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["run", "drive", "--plot", "drive.html", "--quiet"]) == 0
    found, _ = opened(tmp_path / "drive.html")
    assert found["complaints"] == [] and found["asked"] == [] and found["curves"] > 5


def test_motion_of_a_run(compiler: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The page of a motion stands at the time that its address names; bodies stand elsewhere at another."""
    monkeypatch.chdir(tmp_path)
    assert main(["view", "heavy_top", "-o", "top.html"]) == 0
    seen = []
    for time in ("0.1", "0.6"):
        found, picture = opened(tmp_path / "top.html", f"t={time}")
        assert found["complaints"] == [] and found["asked"] == [], found
        assert found["title"] == "heavy_top" and f"{time}0 s" in found["text"]
        seen.append(colours(picture))
    assert len(seen[0]) > 200, "hardly anything is drawn"
    assert len(seen[0] ^ seen[1]) > 200, "nothing has moved"
