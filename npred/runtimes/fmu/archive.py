"""The FMU as a file: its sources compiled for this machine, and a zip archive that is the same each time."""

import os
import platform
import sys
import tempfile
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path

from npred.runtimes import c_library

HIDDEN = "-fvisibility=hidden"  # but what FMI names
SUFFIXES = {"linux": ".so", "darwin": ".dylib", "windows": ".dll"}
MACHINES = {"amd64": "x86_64", "arm64": "aarch64"}
FOLDERS_OF_2 = {("linux", "x86_64"): "linux64", ("darwin", "x86_64"): "darwin64", ("windows", "x86_64"): "win64"}


def place(version: int, identifier: str) -> str | None:
    """Where the library of this machine lies in the archive; None where FMI has no name for the machine."""
    system, machine = platform.system().lower(), platform.machine().lower()
    machine = MACHINES.get(machine, machine)
    folder = f"{machine}-{system}" if version == 3 else FOLDERS_OF_2.get((system, machine))
    return f"binaries/{folder}/{identifier}{SUFFIXES[system]}" if folder and system in SUFFIXES else None


def compiled(texts: Mapping[str, str], sources: Sequence[str]) -> bytes:
    """The shared library of the sources. Raises NpredError, in one line, where they do not compile."""
    with tempfile.TemporaryDirectory() as folder:
        for name, text in texts.items():
            (Path(folder) / name).write_text(text, encoding="utf-8")
        c_library.build([Path(folder) / name for name in sources], Path(folder) / "library", "fmu", HIDDEN)
        return (Path(folder) / "library").read_bytes()


def write(path: Path, files: Mapping[str, str | bytes]) -> None:
    """The archive, its entries in this order, without the time: the same files give the same bytes."""
    handle, temporary = tempfile.mkstemp(dir=path.parent, suffix=".tmp")
    try:
        with os.fdopen(handle, "wb") as target, zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, content in files.items():
                entry = zipfile.ZipInfo(name)  # of the year 1980, as zip counts from there
                entry.compress_type, entry.external_attr, entry.create_system = zipfile.ZIP_DEFLATED, 0o644 << 16, 3
                archive.writestr(entry, content)
        os.replace(temporary, path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise
    if sys.platform != "win32":
        path.chmod(0o644)
