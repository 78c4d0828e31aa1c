"""Verbs used wrongly: one clear line with the remedy, the right exit code, no traceback, and nothing written."""

from __future__ import annotations

from pathlib import Path

import pytest

from phfmu.cli import main

NONE = "no component or scene"

#: command line, what its one line says, in this order
WRONG = [
    ("lst", "invalid choice: 'lst' ; did you mean list? phfmu --help"),
    ("list mass", "unrecognized arguments: mass phfmu list --help"),
    ("check", "required: target phfmu check --help"),
    ("check fourparticle", f"{NONE} 'fourparticle' did you mean four_particle"),
    ("check folder", "folder is no target file.py:function"),
    ("check absent.py", "no file 'absent.py'"),
    ("check empty.py", "empty.py has no function that builds a model phfmu new component NAME"),
    ("check torn.py", "torn.py: SyntaxError line 1"),
    ("check one.py", "one.py gives an int; expected a PHDAE"),
    ("check mass --srict", "unrecognized arguments: --srict; did you mean --strict"),
    ("info empty.fmu", "empty.fmu: not a readable archive export or download it again"),
    ("info mass --al --every", "unrecognized arguments: --every"),
    ("sweep mass --measure max(v)", "one of the arguments --vary --table is required phfmu sweep --help"),
    ("sweep mass --vary k=1:2:3 --table x.csv --measure max(v)", "--table: not allowed with argument --vary"),
    ("sweep mass --vary mm=1:2:3 --measure max(v)", "mass has no parameter, state or input 'mm'; did you mean m?"),
    ("sweep mass --vary m=1:2 --measure max(v)", "--vary m=1:2: expected NAME=FROM:TO:COUNT"),
    ("sweep mass --vary m=1:2:3 --measure mx(v)", "no kind 'mx'; did you mean max"),
    ("sweep mass --table absent.csv --measure max(v)", "--table absent.csv: there is no such file; write one"),
    ("sweep mass --table empty.csv --measure max(v)", "--table empty.csv: Empty CSV file"),
    (
        "sweep mass --vary m=1:2:3 --measure max(v) -o absent/x.parquet",
        "-o absent/x.parquet: there is no folder absent",
    ),
    (
        "sweep mass --vary m=1:2:3 --measure max(v) --resume",
        "--resume goes on with the table of -o FILE; name it",
    ),
    ("audit absent.parquet", "no audit file 'absent.parquet'; write one with: phfmu run"),
    ("audit empty.parquet", "empty.parquet is not an audit log"),
    ("audit x.parquet --by prt", "invalid choice: 'prt' did you mean port, part?"),
    ("audit x.parquet --unit MJJ", "invalid choice: 'MJJ' did you mean MJ"),
    ("bench ordrs", f"{NONE} 'ordrs' did you mean orders?"),
    ("bench sweep -o absent/x.md", "-o absent/x.md: there is no folder 'absent'; make it first"),
    ("bench mass -o empty.csv", "-o empty.csv is a file; name a folder for pages and pictures"),
    ("stress eventz", f"{NONE} 'eventz' did you mean events?"),
    ("stress events -o empty.csv", "-o empty.csv is a file; name a folder for stress.md"),
    ("completion bsh", "invalid choice: 'bsh' did you mean bash"),
    ("new componnt tank", "invalid choice: 'componnt' did you mean component?"),
    ("new component 1tank", "'1tank' is no name of a function e.g. tank"),
    ("new component one", "one.py would be replaced; choose another name or folder"),
    ("new component tank -o absent", "-o absent: there is no such folder; make it first"),
    ("compare x.parquet", "the following arguments are required: B (see"),
    ("compare absent.csv empty.csv", "no file 'absent.csv'; make one with: phfmu run"),
    ("compare folder folder", "folder is a folder; name a file in it that phfmu run wrote"),
    ("compare empty.csv empty.csv", "empty.csv is empty"),
    ("export fourparticle", f"{NONE} 'fourparticle' did you mean four_particle"),
    ("export mass --fmi 4", "--fmi: invalid choice: choose from"),
    ("export mass -o empty.csv", "-o empty.csv is a file; name a folder for the FMUs"),
    ("export mass --tunable mm", "no parameter 'mm' to be tunable; did you mean m?"),
]


@pytest.mark.parametrize(("line", "said"), WRONG, ids=[line for line, _ in WRONG])
def test_wrong_usage_is_one_line(
    line: str, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder").mkdir()
    for name in ("empty.py", "empty.csv", "empty.parquet", "empty.fmu"):
        (tmp_path / name).touch()
    (tmp_path / "torn.py").write_text("def f(:\n", encoding="utf-8")
    (tmp_path / "one.py").write_text("def one():\n    return 1\n", encoding="utf-8")
    before = {p: p.read_bytes() for p in tmp_path.iterdir() if p.is_file()}
    try:
        code = main(line.split())
    except SystemExit as leave:
        code = leave.code
    out, err = capsys.readouterr()
    assert code == 2 and out == ""
    assert err.count("\n") == 1 and err.startswith("phfmu: ")
    place = 0
    for word in said.split():
        place = err.index(word, place)
    assert {p: p.read_bytes() for p in tmp_path.iterdir() if p.is_file() and p.suffix != ".pyc"} == before
