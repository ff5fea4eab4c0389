"""Compiled code on the disk: only its owner may enter it, and what is not as it was written is compiled again."""

import errno
import os
import struct
import subprocess
import sys
from pathlib import Path

import pytest

from npred.errors import ConfigError, NpredError
from npred.store import durable
from npred.symbolic import compile_cache

CONSTANT = 0.123456789
PROGRAM = f"""
import subprocess, sys
from npred.symbolic import compile_cache, kernels
text = "def shifted(a):\\n    return a + {CONSTANT}\\n"
shifted = kernels.build("shifted", "float64(float64)", text)
print(shifted(1.0), sum(shifted._cache_hits.values()), compile_cache.root(), flush=True)
if len(sys.argv) > 1:
    sys.exit(subprocess.run([sys.executable, "-c", sys.argv[1]]).returncode)
"""


def run(*arguments: str, **variables: str | None) -> list[tuple[float, int, Path]]:
    """Value, hits and folder of the kernel in a process, and of the same in a process that it starts."""
    environment = {k: v for k, v in {**os.environ, **variables}.items() if v is not None}
    command = [sys.executable, "-c", PROGRAM, *arguments]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True, timeout=120)
    rows = [line.split() for line in done.stdout.splitlines()]
    return [(float(value), int(hits), Path(folder)) for value, hits, folder in rows]


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cache that holds the kernel."""
    folder = tmp_path_factory.mktemp("cache")
    assert run(NPRED_CACHE=str(folder)) == [(1 + CONSTANT, 0, folder / "kernels")]
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
    ("damage", "name"), [(flip, "*.nbc"), (cut, "*.nbc"), (empty, "*.nbi"), (Path.unlink, compile_cache.SEAL)]
)
def test_damaged_files_are_compiled_again(kept, damage, name):
    (path,) = kept.glob(f"kernels/npred_shifted_*/**/{name}")
    damage(path)
    assert run(NPRED_CACHE=str(kept))[0][:2] == (1 + CONSTANT, 0)
    assert not [*kept.glob("kernels/.*")]


def test_another_text_in_a_kernels_file_is_not_run(kept):
    (path,) = kept.glob("kernels/npred_shifted_*.py")
    wanted = path.read_text()
    path.write_text("raise SystemExit('planted')\n" + wanted)
    assert run(NPRED_CACHE=str(kept))[0][:2] == (1 + CONSTANT, 1)
    assert path.read_text() == wanted


def test_functions_of_modules_are_kept_there_too(tmp_path):
    module = "from npred.symbolic.compile_cache import jit\n\n@jit('float64(float64)')\ndef same(a):\n    return a\n"
    (tmp_path / "module.py").write_text(module + "print(sum(same._cache_hits.values()))\n")
    environment = {**os.environ, "NPRED_CACHE": str(tmp_path), "NUMBA_CACHE_DIR": str(tmp_path / "numba")}
    command = [sys.executable, str(tmp_path / "module.py")]
    hits = [subprocess.run(command, env=environment, capture_output=True, check=True).stdout for _ in range(2)]
    assert hits == [b"0\n", b"1\n"]
    assert [*tmp_path.glob("kernels/npred_module_same_*/**/*.nbc")] and not (tmp_path / "numba").exists()


@pytest.mark.parametrize("mask", [0, 0o277])
def test_nobody_else_enters_the_folder_whatever_the_mask(tmp_path, monkeypatch, mask):
    monkeypatch.setenv("NPRED_CACHE", str(tmp_path / "cache"))
    before = os.umask(mask)
    try:
        folder = compile_cache.folder()
    finally:
        os.umask(before)
    assert [level.stat().st_mode & 0o777 for level in (folder, folder.parent)] == [0o700, 0o700]


def test_readers_lose_an_older_folder(tmp_path, monkeypatch):
    monkeypatch.setenv("NPRED_CACHE", str(tmp_path))
    (tmp_path / "kernels").mkdir()
    (tmp_path / "kernels").chmod(0o755)
    assert compile_cache.folder().stat().st_mode & 0o777 == 0o700


@pytest.mark.parametrize("mode", [0o770, 0o702, 0o777])
def test_a_folder_that_others_write_to_is_refused(tmp_path, monkeypatch, mode):
    monkeypatch.setenv("NPRED_CACHE", str(tmp_path))
    (tmp_path / "kernels").mkdir()
    (tmp_path / "kernels").chmod(mode)
    with pytest.raises(ConfigError, match=f"kernels: expected a folder that only you can write to.*{mode:o}.*remove"):
        compile_cache.folder()


def test_the_folder_of_another_user_is_refused(tmp_path, monkeypatch):
    monkeypatch.setenv("NPRED_CACHE", str(tmp_path))
    monkeypatch.setattr(os, "geteuid", lambda: tmp_path.stat().st_uid + 1)
    with pytest.raises(ConfigError, match="only you can write to"):
        compile_cache.folder()


@pytest.mark.parametrize("unset", ["NPRED_CACHE", "XDG_CACHE_HOME"])
def test_an_empty_variable_is_unset(tmp_path, monkeypatch, unset):
    for name in ("NPRED_CACHE", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv(unset, "")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert compile_cache.folder() == tmp_path / ".cache" / "npred" / "kernels"


@pytest.mark.parametrize("name", ["NPRED_CACHE", "XDG_CACHE_HOME"])
def test_a_relative_folder_is_refused(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv(name, "cache")
    with pytest.raises(ConfigError, match=f"{name}: expected an absolute path, got 'cache'"):
        compile_cache.folder()
    assert not [*tmp_path.iterdir()]


def test_without_a_home_the_processes_share_a_folder_that_is_removed(tmp_path):
    temporary = tmp_path / "tmp"
    temporary.mkdir()
    (tmp_path / "file").write_text("no folder")
    parent, child = run(PROGRAM, NPRED_CACHE=str(tmp_path / "file"), TMPDIR=str(temporary))
    assert parent[2] == child[2] and temporary in child[2].parents
    assert (parent[1], child[1]) == (0, 1)
    assert not [*temporary.iterdir()]


def test_no_relative_home_is_taken(tmp_path, monkeypatch):
    for name in ("NPRED_CACHE", "XDG_CACHE_HOME"):
        monkeypatch.setenv(name, "")
    monkeypatch.setenv("HOME", ".")
    monkeypatch.setattr(compile_cache, "_temporary", lambda: tmp_path)
    assert compile_cache.folder() == tmp_path


def test_a_full_disk_is_that_of_the_cache(tmp_path, monkeypatch):
    def fail(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setenv("NPRED_CACHE", str(tmp_path))
    monkeypatch.setattr(compile_cache.tempfile, "TemporaryFile", fail)
    full = pytest.raises(NpredError, match="kernels: expected room for compiled code, got a full disk")
    with full as caught, durable.room(tmp_path / "store"):
        compile_cache.folder()
    assert "store" not in str(caught.value)


def test_a_disk_that_fills_while_numba_writes_is_that_of_the_cache(tmp_path, monkeypatch):
    monkeypatch.setattr(compile_cache, "root", lambda: tmp_path)
    full = pytest.raises(NpredError, match=f"{tmp_path}: expected room for compiled code")
    with full as caught, durable.room(tmp_path / "store"), compile_cache.kept("npred_none"):
        raise OSError(errno.ENOSPC, "No space left on device")
    assert "store" not in str(caught.value) and not [*tmp_path.iterdir()]


def test_of_two_that_compile_the_same_one_is_kept(tmp_path, monkeypatch):
    monkeypatch.setattr(compile_cache, "root", lambda: tmp_path)
    with compile_cache.kept("npred_a"):
        _compiled("slower")
        with compile_cache.kept("npred_a"):
            _compiled("faster")
    assert [path.name for path in tmp_path.iterdir()] == ["npred_a"]
    assert (tmp_path / "npred_a" / "file").read_text() == "faster"


def _compiled(text: str) -> None:
    from numba.core import config

    Path(config.CACHE_DIR, "file").write_text(text)  # type: ignore[attr-defined]


def test_nothing_else_is_left_to_numbas_own_cache():
    package = Path(compile_cache.__file__).parents[1]
    caching = {path.name for path in package.rglob("*.py") if "cache=True" in path.read_text(encoding="utf-8")}
    assert caching == {"compile_cache.py", "kernels.py"}
