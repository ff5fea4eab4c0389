"""Small files from anywhere: what is too long, too deep, or no file at all is a ValueError or an OSError."""

import os
from pathlib import Path

import numpy as np
import pytest

from npred.base import json_files


def test_a_table_is_read(tmp_path: Path):
    (tmp_path / "a.json").write_text('{"mse": 0.5}')
    assert json_files.table(tmp_path / "a.json") == {"mse": 0.5}


@pytest.mark.parametrize("text", ["[1]", "3", "{", "[" * 100_000, '{"a": ' + "9" * 5000 + "}", "\xff"])
def test_what_is_no_table_is_refused(tmp_path: Path, text: str):
    (tmp_path / "a.json").write_bytes(text.encode("latin-1"))
    with pytest.raises(ValueError, match=r"JSON|Expecting|integer|utf-8"):
        json_files.table(tmp_path / "a.json")


def test_what_is_too_long_is_not_read(tmp_path: Path):
    (tmp_path / "a.json").write_text("[1, 2]")
    assert json_files.read(tmp_path / "a.json", limit=6) == b"[1, 2]"
    with pytest.raises(ValueError, match="6 bytes, more than 5"):
        json_files.read(tmp_path / "a.json", limit=5)


def test_links_and_pipes_are_not_opened(tmp_path: Path):
    (tmp_path / "link").symlink_to("/etc/passwd")
    os.mkfifo(tmp_path / "pipe")
    for name in ("link", "pipe", "."):
        with pytest.raises(ValueError, match="a link, a folder or a device"):
            json_files.read(tmp_path / name)
    with pytest.raises(FileNotFoundError):
        json_files.read(tmp_path / "nothing")


def test_what_moves_a_cursor_is_spelt_out():
    strange = {"a\x1b[2J\n": ["\x9b1m", "\u202e", "\ud800", 1, None, {"ε µ": "\\x1b"}]}
    plain = {r"a\x1b[2J\n": [r"\x9b1m", r"\u202e", r"\ud800", 1, None, {"ε µ": r"\x1b"}]}
    assert json_files.escaped(strange) == plain


def test_what_is_read_whole_is_a_file(tmp_path: Path):
    (tmp_path / "file").write_text("1")
    (tmp_path / "link").symlink_to(tmp_path / "file")
    os.mkfifo(tmp_path / "pipe")
    for name in ("file", "link", "missing"):
        assert json_files.regular(tmp_path / name) == tmp_path / name
    for path in (tmp_path / "pipe", tmp_path, Path("/dev/zero")):
        with pytest.raises(OSError, match="a pipe, a device or a folder"):
            json_files.regular(path)


def test_values_become_plain_json():
    value = {"a": np.float64(1.5), "b": np.array([1.0, np.inf]), 3: (float("nan"), True, "x", None, np.int32(4))}
    assert json_files.plain(value) == {"a": 1.5, "b": [1.0, None], "3": [None, True, "x", None, 4]}
