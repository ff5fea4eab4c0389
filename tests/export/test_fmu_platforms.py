"""FMUs for other machines, compiled by ziglang: the formats of their libraries, and the one of Windows under Wine."""

import os
import shutil
import struct
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
from c_controllers import closed_loop, differ
from conftest import HERE
from fmus import exported
from operator_samples import SMALL, operator

import npred
from npred.base import errors
from npred.base.errors import ConfigError, MissingError
from npred.exports import fmu
from npred.loop.controller import Controller
from npred.networks.fused import Fused

PLANT, DT = npred.plant("activator_repressor"), 0.01
PAPER = npred.DelayAdaptation(1000.0, bounds=(0.1, 4.0))
NX = 21
WINE = shutil.which("wine64") or shutil.which("wine64", path="/usr/lib/wine")
needs_zig = pytest.mark.skipif(not errors.installed("ziglang"), reason="needs pip install 'npred[zig]'")
needs_wine = pytest.mark.skipif(WINE is None, reason="needs Wine")
FORMATS = {  # by the place in the archive: where the magic and the machine stand
    "x86_64-linux/npred.so": ("ELF", 62),
    "aarch64-linux/npred.so": ("ELF", 183),
    "x86_64-windows/npred.dll": ("PE", 0x8664),
    "x86_64-darwin/npred.dylib": ("Mach-O", 0x01000007),
    "aarch64-darwin/npred.dylib": ("Mach-O", 0x0100000C),
}


def heun() -> Controller:
    return npred.controller(PLANT, npred.predictor(PLANT, "heun", NX), PAPER, DT, D_hat=2.0, actuator="measured")


def guarded_network() -> Controller:
    fused = Fused(PLANT, operator(SMALL[0]).double(), NX, precision=np.float64)
    return npred.controller(PLANT, npred.guarded(fused, 0.01), PAPER, DT, D_hat=2.0, actuator="measured")


def form(library: bytes) -> tuple[str, int]:
    """The format of a library and the number of its machine."""
    if library.startswith(b"\x7fELF"):
        return "ELF", struct.unpack_from("<H", library, 18)[0]
    if library.startswith(b"MZ"):
        (at,) = struct.unpack_from("<I", library, 0x3C)
        assert library[at : at + 4] == b"PE\0\0"
        return "PE", struct.unpack_from("<H", library, at + 4)[0]
    magic, machine = struct.unpack_from("<II", library)
    assert magic == 0xFEEDFACF
    return "Mach-O", machine


@pytest.mark.campaign
@needs_zig
def test_each_library_is_of_its_machine(tmp_path):
    names = ["linux64", "win64", "darwin64", "aarch64-linux", "aarch64-darwin"]
    path, written = exported(heun(), tmp_path, platforms=names)
    with zipfile.ZipFile(path) as archive:
        libraries = {place.removeprefix("binaries/"): archive.read(place) for place in written.facts["libraries"]}
    assert {place: form(library) for place, library in libraries.items()} == FORMATS
    assert all(b"fmi3DoStep" in library and b"fmi3GetFloat64" in library for library in libraries.values())


@pytest.mark.parametrize(("version", "name"), [(3, "win32"), (2, "aarch64-linux")])
def test_a_platform_without_a_name_is_told(tmp_path, version, name):
    with pytest.raises(ConfigError, match=f"^platforms: expected some of linux64.*, got '{name}'"):
        exported(heun(), tmp_path, version, platforms=[name])


def test_without_ziglang_other_platforms_say_how_to_get_it(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "ziglang", None)
    with pytest.raises(
        MissingError, match=r"export fmu: expected the package ziglang, found none; pip install 'npred\[zig\]'"
    ):
        exported(heun(), tmp_path, platforms=["win64"])


def test_both_versions_have_their_names_of_a_platform():
    assert fmu.NAMED["win64"].place(2, "a") == "binaries/win64/a.dll"
    assert fmu.NAMED["win64"].place(3, "a") == "binaries/x86_64-windows/a.dll"
    assert fmu.NAMED["aarch64-darwin"].place(3, "a") == "binaries/aarch64-darwin/a.dylib"


class Recorded:
    """A controller, and what each of its steps took and gave."""

    def __init__(self, controller: Controller) -> None:
        self.controller, self.taken, self.given = controller, [], []

    def step(self, X, *measured):
        self.taken.append([*X, *np.ravel(measured[0])])
        self.given.append(np.array(self.controller.step(X, *measured[:1])))
        return self.given[-1]


@pytest.fixture(scope="module")
def driver(tmp_path_factory) -> Path:
    """The program for Windows."""
    program = tmp_path_factory.mktemp("driver") / "driver.exe"
    words = ["-m", "ziglang", "cc", "-target", "x86_64-windows-gnu", "-O1", str(HERE / "runtimes" / "wine_driver.c")]
    subprocess.run([sys.executable, *words, "-o", str(program)], check=True)
    return program


@pytest.mark.campaign
@needs_zig
@needs_wine
@pytest.mark.parametrize("make", [heun, guarded_network])
def test_the_library_of_windows_steps_as_the_controller(driver, tmp_path, make):
    run = Recorded(make())
    closed_loop(run, PLANT, 1.0, DT, 1000, [0.03, 30.0], True, NX)
    path, written = exported(make(), tmp_path, platforms=["win64"])
    (library,) = written.facts["libraries"]
    zipfile.ZipFile(path).extract(library, tmp_path)
    blocks = {
        name: [k for k, one in enumerate(written.variables) if one.block == name] for name in ("X", "ACTUATOR", "U")
    }
    inputs = blocks["X"] + blocks["ACTUATOR"]
    head = [f"Z:{tmp_path / library}", written.facts["token"], DT, len(run.taken)]
    head += [len(inputs), *inputs, len(run.taken[0]), len(blocks["U"]), *blocks["U"], len(run.given[0])]
    text = "\n".join(map(str, [*head, *np.ravel(run.taken).tolist()]))
    environment = os.environ | {"WINEPREFIX": str(tmp_path / "wine"), "WINEDEBUG": "-all"}
    done = subprocess.run([str(WINE), str(driver)], input=text, capture_output=True, text=True, env=environment)
    assert done.returncode == 0, done.stderr
    U = np.array(list(map(float, done.stdout.split()))).reshape(-1, PLANT.m)
    error = differ(U, np.array(run.given))
    print(f"Windows' library under Wine: U within {error:.2g} of npred.controller over {len(U)} steps")
    assert error < 1e-12
