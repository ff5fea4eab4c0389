"""Plants of installed packages: found by name, listed, and not imported before they are asked for."""

import sys

import pytest
from conftest import TANK
from typer.testing import CliRunner

from npred import plants
from npred.cli import app
from npred.errors import ConfigError


@pytest.fixture
def package(tmp_path, monkeypatch):
    """Install a package that registers plants, as `pip install` leaves it."""

    def install(entries: str, text: str = TANK) -> None:
        (tmp_path / "shed_of_tanks.py").write_text(text)
        info = tmp_path / "shed_of_tanks-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text("Metadata-Version: 2.1\nName: shed-of-tanks\nVersion: 1.0\n")
        (info / "entry_points.txt").write_text(f"[npred.plants]\n{entries}\n")

    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "shed_of_tanks", raising=False)
    yield install
    sys.modules.pop("shed_of_tanks", None)


def test_a_registered_plant_is_found_listed_and_lazily_imported(package):
    package("round_tank = shed_of_tanks:Tank")
    assert plants.resolve("scalar").n == 1
    with pytest.raises(ConfigError, match=r"expected one of .*, round_tank, or a file"):
        plants.resolve("nonesuch")
    assert "shed_of_tanks" not in sys.modules
    tank = plants.resolve("round_tank")
    assert (tank.name, tank.states, tank.equilibrium.tolist()) == ("round_tank", ("h",), [1.0])
    assert tank.source is not None and tank.source.file == "shed_of_tanks.py"
    assert "round_tank" in [row["name"] for row in plants.named()]


def test_a_built_in_name_cannot_be_taken(package):
    package("scalar = shed_of_tanks:Tank")
    assert plants.resolve("scalar").states == ("X",)
    assert [row["name"] for row in plants.named()].count("scalar") == 1


def test_a_broken_package_hides_no_other_plant(package):
    package("round_tank = shed_of_tanks:Tank", "import nowhere")
    rows = {row["name"]: row for row in plants.named()}
    assert "failed on import" in rows["round_tank"]["error"] and rows["scalar"]["states"] == ["X"]
    listed = CliRunner().invoke(app, ["plants"])
    assert listed.exit_code == 0 and "scalar" in listed.stdout
    assert listed.stderr.startswith("warning: plant round_tank: shed-of-tanks failed on import")


@pytest.mark.parametrize(
    ("entry", "text", "words"),
    [
        ("round_tank = shed_of_tanks:Tank", "import nowhere", "shed-of-tanks failed on import of shed_of_tanks:Tank"),
        ("round_tank = shed_of_tanks:Vat", TANK, "failed on import of shed_of_tanks:Vat: AttributeError"),
        (
            "round_tank = shed_of_tanks:Tank",
            "Tank = 3",
            "plant round_tank: expected states, inputs, f, kappa, found no states",
        ),
    ],
)
def test_a_broken_package_is_told_by_name(package, entry, text, words):
    package(entry, text)
    with pytest.raises(ConfigError, match=words):
        plants.resolve("round_tank")
