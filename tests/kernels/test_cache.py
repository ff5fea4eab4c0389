"""Compiled code on the disk: only its owner may enter it, and what is not as it was written is compiled again."""

import errno
import os
import shutil
import struct
import subprocess
import sys
from pathlib import Path

import pytest

from npred.base.errors import MissingError, NpredError, room_on_disk
from npred.kernels import cache, compiler

CONSTANT = 0.123456789
PROGRAM = f"""
import subprocess, sys
from npred.kernels import cache, compiler
text = "double shifted(double a) {{ return a + {CONSTANT}; }}"
shifted = compiler.library(text).shifted
shifted.restype, shifted.argtypes = compiler.ctypes.c_double, [compiler.ctypes.c_double]
compiled = [*cache.root().glob("npred_*/kernel.so")][0].stat().st_mtime_ns
print(shifted(1.0), compiled, cache.root(), flush=True)
if len(sys.argv) > 1:
    sys.exit(subprocess.run([sys.executable, "-c", sys.argv[1]]).returncode)
"""


def run(*arguments: str, **variables: str | None) -> list[tuple[float, int, Path]]:
    """Value, time of compilation and folder of the kernel in a process, and of the same in one that it starts."""
    environment = {k: v for k, v in {**os.environ, **variables}.items() if v is not None}
    command = [sys.executable, "-c", PROGRAM, *arguments]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True, timeout=120)
    rows = [line.split() for line in done.stdout.splitlines()]
    return [(float(value), int(stamp), Path(folder)) for value, stamp, folder in rows]


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cache that holds the kernel."""
    folder = tmp_path_factory.mktemp("cache")
    [(value, stamp, root)] = run(NPRED_CACHE=str(folder))
    assert (value, root) == (1 + CONSTANT, folder / "kernels")
    assert run(NPRED_CACHE=str(folder)) == [(value, stamp, root)]  # found, not compiled
    return folder


def flip(path: Path) -> None:
    content = bytearray(path.read_bytes())
    at = content.find(struct.pack("<d", CONSTANT))
    content[at + 6 if at >= 0 else len(content) // 2] ^= 4
    path.write_bytes(content)


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:100])


def empty(path: Path) -> None:
    path.write_bytes(b"")


@pytest.mark.parametrize(
    ("damage", "name"),
    [(flip, compiler.LIBRARY), (cut, compiler.LIBRARY), (empty, compiler.TEXT), (Path.unlink, cache.SEAL)],
)
def test_damaged_files_are_compiled_again(kept, damage, name):
    [(_, before, _)] = run(NPRED_CACHE=str(kept))
    (path,) = kept.glob(f"kernels/npred_*/{name}")
    damage(path)
    [(value, after, _)] = run(NPRED_CACHE=str(kept))
    assert value == 1 + CONSTANT and after != before
    assert not [*kept.glob("kernels/.*")]


@pytest.mark.parametrize("mask", [0, 0o277])
def test_nobody_else_enters_the_folder_whatever_the_mask(tmp_path, monkeypatch, mask):
    monkeypatch.setenv("NPRED_CACHE", str(tmp_path / "cache"))
    before = os.umask(mask)
    try:
        folder = cache.folder()
    finally:
        os.umask(before)
    assert [level.stat().st_mode & 0o777 for level in (folder, folder.parent)] == [0o700, 0o700]


def test_readers_lose_an_older_folder(tmp_path, monkeypatch):
    monkeypatch.setenv("NPRED_CACHE", str(tmp_path))
    (tmp_path / "kernels").mkdir()
    (tmp_path / "kernels").chmod(0o755)
    assert cache.folder().stat().st_mode & 0o777 == 0o700


@pytest.mark.parametrize("mode", [0o770, 0o702, 0o777])
def test_a_folder_that_others_write_to_is_refused(tmp_path, monkeypatch, mode):
    monkeypatch.setenv("NPRED_CACHE", str(tmp_path))
    (tmp_path / "kernels").mkdir()
    (tmp_path / "kernels").chmod(mode)
    with pytest.raises(MissingError, match=f"kernels: expected a folder that only you can write to.*{mode:o}.*remove"):
        cache.folder()


def test_the_folder_of_another_user_is_refused(tmp_path, monkeypatch):
    monkeypatch.setenv("NPRED_CACHE", str(tmp_path))
    monkeypatch.setattr(os, "geteuid", lambda: tmp_path.stat().st_uid + 1)
    with pytest.raises(MissingError, match="only you can write to"):
        cache.folder()


@pytest.mark.parametrize("unset", ["NPRED_CACHE", "XDG_CACHE_HOME"])
def test_an_empty_variable_is_unset(tmp_path, monkeypatch, unset):
    for name in ("NPRED_CACHE", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv(unset, "")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert cache.folder() == tmp_path / ".cache" / "npred" / "kernels"


@pytest.mark.parametrize("name", ["NPRED_CACHE", "XDG_CACHE_HOME"])
def test_a_relative_folder_is_refused(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv(name, "cache")
    with pytest.raises(MissingError, match=f"{name}: expected an absolute path, got 'cache'"):
        cache.folder()
    assert not [*tmp_path.iterdir()]


def test_without_a_home_the_processes_share_a_folder_that_is_removed(tmp_path):
    temporary = tmp_path / "tmp"
    temporary.mkdir()
    (tmp_path / "file").write_text("no folder")
    parent, child = run(PROGRAM, NPRED_CACHE=str(tmp_path / "file"), TMPDIR=str(temporary))
    assert parent[2] == child[2] and temporary in child[2].parents
    assert parent[1] == child[1]
    assert not [*temporary.iterdir()]


def test_no_relative_home_is_taken(tmp_path, monkeypatch):
    for name in ("NPRED_CACHE", "XDG_CACHE_HOME"):
        monkeypatch.setenv(name, "")
    monkeypatch.setenv("HOME", ".")
    monkeypatch.setattr(cache, "_temporary", lambda: tmp_path)
    assert cache.folder() == tmp_path


def test_a_full_disk_is_that_of_the_cache(tmp_path, monkeypatch):
    def fail(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setenv("NPRED_CACHE", str(tmp_path))
    monkeypatch.setattr(cache.tempfile, "TemporaryFile", fail)
    full = pytest.raises(NpredError, match="kernels: expected room for compiled code, got a full disk")
    with full as caught, room_on_disk(tmp_path / "store"):
        cache.folder()
    assert "store" not in str(caught.value)


def test_a_disk_that_fills_while_the_compiler_writes_is_that_of_the_cache(tmp_path, monkeypatch):
    def fail(folder: Path, flags: tuple[str, ...]) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(cache, "root", lambda: tmp_path)
    monkeypatch.setattr(compiler, "_compile", fail)
    full = pytest.raises(NpredError, match=f"{tmp_path}: expected room for compiled code")
    with full as caught, room_on_disk(tmp_path / "store"):
        compiler.library("int none;")
    assert "store" not in str(caught.value) and not [*tmp_path.iterdir()]


def test_of_two_that_compile_the_same_one_is_kept(tmp_path, monkeypatch):
    monkeypatch.setattr(cache, "root", lambda: tmp_path)
    for text in ("faster", "slower"):
        aside = cache.aside()
        (aside / "file").write_text(text)
        cache.install(aside, tmp_path / "npred_a")
        if aside.exists():
            shutil.rmtree(aside)
    assert [path.name for path in tmp_path.iterdir()] == ["npred_a"]
    assert (tmp_path / "npred_a" / "file").read_text() == "faster"
