"""`npred identify`: a recording in, sentences, a page and a pipeline out; each failure is one line."""

import contextlib
import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from typer.testing import CliRunner, Result

import npred
from npred.base.errors import ConfigError
from npred.cli import app
from npred.identification.identify import of_log
from npred.lab import config
from npred.lab.stages.identify import identify as stage

LOG = Path(__file__).parent / "tank_log.csv"
PLANT = """
class Tank:
    states, inputs = ("h",), ("q",)
    parameters = {"area": 1.0, "outflow": 0.5, "level": 1.0, "gain": 1.0}
    box, guess = {"h": (0.5, 2.0)}, (1.0,)

    def f(x, u, t, p, M):
        return [(u.q - p.outflow * M.sqrt(x.h)) / p.area]

    def kappa(x, t, p, M):
        return [p.outflow * M.sqrt(x.h) - p.gain * (x.h - p.level)]

    def V(x, t, p, M):
        return (x.h - p.level) ** 2
"""
TRUTH = {"D": 0.43, "area": 1.05, "outflow": 0.52}  # of the file that made the recording
FLAGS = ("--plant", "my_plant.py:Tank", "--input", "q=Q1", "--state", "h=level", "--free", "area", "--free", "outflow")


def fill(folder: Path) -> Path:
    """A folder with the plant and the recording."""
    (folder / "my_plant.py").write_text(PLANT)
    shutil.copy(LOG, folder / "log.csv")
    return folder


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return fill(tmp_path)


@pytest.fixture(scope="module")
def answered(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The store after the recording was asked with FLAGS, its figures drawn."""
    here = fill(tmp_path_factory.mktemp("answered"))
    with contextlib.chdir(here):
        assert call("log.csv", *FLAGS).exit_code == 0
    return here / "artifacts"


@pytest.fixture
def known(answered: Path, folder: Path) -> Path:
    """The folder with that store: the same question is answered from it."""
    shutil.copytree(answered, folder / "artifacts")
    return folder


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """No figures are drawn as files: a test without it draws the same ones."""
    monkeypatch.setattr(stage, "write", lambda figure, folder: None)


def call(*arguments: str) -> Result:
    return CliRunner().invoke(app, ["identify", *arguments])


@pytest.mark.usefixtures("known", "drawn")
def test_a_recording_gives_the_delay_the_parameters_a_page_and_a_pipeline(folder: Path):
    done = call("log.csv", *FLAGS, "--json")
    assert done.exit_code == 0, done.output
    answer = json.loads(done.stdout)
    assert abs(answer["D"][0] - TRUTH["D"]) < 0.01 and answer["identifiable"] == [True]
    assert answer["interval"][0][0] <= TRUTH["D"] <= answer["interval"][0][1]
    assert all(abs(answer["parameters"][name] - TRUTH[name]) < 0.01 for name in ("area", "outflow"))
    assert answer["held_back"]["model"] < 0.2 * answer["held_back"]["no_delay"]
    assert answer["files"] == ["log.html", "log.toml"]
    pipeline = config.load(folder / "log.toml")
    assert pytest.approx(answer["D"][0], rel=1e-5) == pipeline.evaluate.D
    assert pipeline.evaluate.bounds == pytest.approx(answer["interval"][0], rel=1e-5)
    assert pipeline.parameters == pytest.approx(answer["parameters"])
    page = (folder / "log.html").read_text()
    assert answer["sentences"][1] in page and page.count("<svg") >= 6


@pytest.mark.usefixtures("undrawn")
def test_a_recording_asks_for_no_box_and_no_law_that_settles(folder: Path):
    """Parameters that are to be estimated may be such that the law does not settle yet."""
    file = folder / "my_plant.py"
    file.write_text(
        PLANT.replace('box, guess = {"h": (0.5, 2.0)}, ', "guess = ").replace('"gain": 1.0', '"gain": -9.0')
    )
    done = call("log.csv", *FLAGS)
    assert done.exit_code == 3 and "q arrives 0.4" in done.stdout
    assert "npred plants check would say no for stability" in done.stderr


@pytest.mark.usefixtures("known", "undrawn")
def test_a_second_call_takes_the_answer_from_the_store_and_another_recording_does_not(folder: Path):
    assert call("log.csv", *FLAGS).exit_code == 0
    plan = json.loads(call("log.csv", *FLAGS, "--json", "-v").stdout)
    (store,) = (folder / "artifacts" / "identify").iterdir()
    with h5py.File(store / "identified.h5") as file:
        assert file["fitted"].shape == file["Y"].shape and np.isfinite(file["fitted"]).all()
    text = (folder / "log.csv").read_text().replace("0.98848", "0.98849")
    (folder / "log.csv").write_text(text)
    again = json.loads(call("log.csv", *FLAGS, "--json").stdout)
    assert len(list((folder / "artifacts" / "identify").iterdir())) == 2
    assert again["D"] == pytest.approx(plan["D"], abs=1e-3)


def test_a_pipeline_may_name_the_recording(folder: Path):
    (folder / "tank.toml").write_text(
        'plant = "my_plant.py:Tank"\n[identify]\ndata = "log.csv"\ncolumns = { q = "Q1", h = "level" }\n'
        "bounds = { area = [0.5, 2.0] }\ntime_varying = true\n"
    )
    answer = json.loads(call("tank.toml", "-o", "found.toml", "--json").stdout)
    assert set(answer["parameters"]) == {"area"} and len(answer["windows"]["t"]) == len(answer["windows"]["D"]) > 1
    assert answer["files"] == ["found.html", "found.toml"]
    page = (folder / "found.html").read_text()
    assert "The delay of q by window (s)" in page and "a first-order lag in its place" in page


def test_no_pipeline_is_written_where_the_recording_does_not_tell(folder: Path):
    lines = (folder / "log.csv").read_text().splitlines()
    rows = [lines[0], *(f"{row.split(',')[0]},{row.split(',')[1] and '0.5'},{row.split(',')[2]}" for row in lines[1:])]
    (folder / "still.csv").write_text("\n".join(rows) + "\n")
    done = call("still.csv", *FLAGS)
    assert done.exit_code == 3 and "q never changes" in done.stdout and (folder / "still.html").exists()
    last = done.output.splitlines()[-1]
    assert "no pipeline was written" in last and "--accept takes the possible range, 0 to " in last
    assert not (folder / "still.toml").exists()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"refused": True}, "the recording contradicts the model"),
        (
            {"identifiable": np.array([False]), "interval": np.array([[0.0, np.inf]])},
            "the recording leaves no bounded range of the delay; give --longest",
        ),
    ],
)
def test_some_recordings_give_no_pipeline_even_with_accept(
    folder: Path, monkeypatch: pytest.MonkeyPatch, change: dict[str, Any], words: str
):
    monkeypatch.setattr(stage, "of_log", lambda *of: replace(of_log(*of), **change))
    done = call("log.csv", *FLAGS, "--accept")
    assert done.exit_code == 3 and words in done.output.splitlines()[-1], done.output
    assert (folder / "log.html").exists() and not (folder / "log.toml").exists()


def test_a_range_is_accepted_and_the_estimate_searches_it(folder: Path):
    done = call("log.csv", *FLAGS, "--longest", "0.4", "--accept")  # shorter than the delay
    assert done.exit_code == 0 and "was accepted as a range" in done.stdout, done.output
    loop = config.load(folder / "log.toml").evaluate
    low, high = loop.bounds
    assert low < loop.D_hat < loop.D < high == pytest.approx(0.4) and loop.adaptation == "delay-observer"


def test_several_recordings_are_one_question(folder: Path):
    shutil.copy(LOG, folder / "more.csv")
    answer = json.loads(call("log.csv", "more.csv", *FLAGS, "--json").stdout)
    assert answer["files"] == ["log.html", "log.toml"]
    assert "log.csv, more.csv" in (folder / "log.html").read_text()
    assert (folder / "log.toml").read_text().startswith("# made by npred identify log.csv more.csv")
    (folder / "more.csv").write_text((folder / "more.csv").read_text().replace("0.98848", "0.98849"))
    assert call("log.csv", "more.csv", *FLAGS).exit_code == 0
    assert len(list((folder / "artifacts" / "identify").iterdir())) == 2


@pytest.mark.usefixtures("known")
def test_the_pipeline_beside_a_plant_in_another_folder_finds_it(folder: Path):
    (folder / "out").mkdir()
    assert call("log.csv", *FLAGS, "-o", "out/tank.toml").exit_code == 0
    assert npred.plants.resolve(*config.load("out/tank.toml").of_plant).name == "Tank"


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("law", [("--set", "kappa=lqr"), ()])
def test_the_pipeline_of_a_designed_law_has_that_law_and_a_delay_law_that_takes_no_V(folder: Path, law):
    (folder / "my_plant.py").write_text(PLANT.split("    def kappa")[0])
    done = call("log.csv", *FLAGS, *law)
    assert done.exit_code == 0, done.output
    pipeline = config.load(folder / "log.toml")
    assert pipeline.kappa == "lqr"
    assert pipeline.generate.adaptation == pipeline.evaluate.adaptation == "delay-observer"
    assert CliRunner().invoke(app, ["run", "log.toml", "--dry-run"]).exit_code == 0


@pytest.mark.usefixtures("known", "undrawn")
def test_a_column_in_another_unit_is_said(folder: Path):
    sentence = "in the recording, and 0.5 to 2 in the plant's box: if the units differ, scale its column."
    assert sentence not in call("log.csv", *FLAGS).stdout
    assert sentence in call("log.csv", *FLAGS, "--scale", "level=100").stdout
    plant = (folder / "my_plant.py").read_text()
    (folder / "my_plant.py").write_text(plant.replace("    box,", '    units = {"h": "rad"}\n    box,'))
    degrees = f"{sentence[:-1]}, from degrees by the factor 0.0174533."
    assert degrees in call("log.csv", *FLAGS, "--scale", "level=57.3").stdout


@pytest.mark.usefixtures("undrawn")
def test_files_are_named_after_the_pipeline_file_and_the_pipeline_stays(folder: Path):
    (folder / "servo.toml").write_text('plant = "my_plant.py:Tank"\n[identify]\ndata = "log.csv"\n')
    before = (folder / "servo.toml").read_text()
    answer = json.loads(call("servo.toml", *FLAGS[2:], "--json").stdout)
    assert answer["files"] == ["servo-identified.html", "servo-identified.toml"]
    assert (folder / "servo.toml").read_text() == before


@pytest.mark.usefixtures("known")
def test_a_file_of_somebody_else_is_left_alone(folder: Path):
    (folder / "log.toml").write_text('plant = "scalar"\n')
    done = call("log.csv", *FLAGS)
    assert done.exit_code == 2 and "name another by -o" in done.output
    assert (folder / "log.toml").read_text() == 'plant = "scalar"\n'


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("log.csv",), "--plant: expected the plant of log.csv, got none"),
        ((), "expected a recording, got none"),
        (("log.csv", "log.toml", *FLAGS), "expected recordings, or one pipeline, got log.csv, log.toml"),
        (("log.csv", *FLAGS, "--hold", "cubic"), "identify.hold: expected 'zero' or 'linear', got 'cubic'"),
        (("log.csv", *FLAGS, "--period", "0"), "identify.period"),
        (("other.csv", *FLAGS), "expected a file at other.csv"),
        (("log.csv", "--plant", "my_plant.py:Tank", "--input", "q=Q2", "--state", "h=level"), "got 'Q2'"),
        (("log.csv", "--plant", "my_plant.py:Tank", "--input", "q=Q1"), "expected a column for one of h"),
        (("log.csv", *FLAGS, "--input", "p=Q1"), "expected inputs or outputs of plant Tank, q, h, got 'p'; name one"),
        (
            ("log.csv", *FLAGS, "--scale", "levl=0.01"),
            "columns that are read, Q1, level, got 'levl'; did you mean level?",
        ),
        (("log.csv", *FLAGS, "--shift", "h=1"), "columns that are read, Q1, level, got 'h'"),
        (("log.csv", *FLAGS, "--bounds", "area=2"), "identify.bounds.area"),
        (("log.csv", *FLAGS, "--scale", "level"), "expected --scale COLUMN=FACTOR, got 'level'"),
        (("log.csv", *FLAGS, "--free", "araa"), "got 'araa'"),
    ],
)
def test_a_failure_is_one_line(arguments: tuple[str, ...], words: str):
    done = call(*arguments, "-q")
    assert done.exit_code == 2 and words in done.output, done.output
    assert len(done.output.strip().splitlines()) == 1


@pytest.mark.usefixtures("known")
def test_gc_keeps_what_a_recording_has_told(folder: Path):
    assert call("log.csv", *FLAGS).exit_code == 0
    done = CliRunner().invoke(app, ["gc", "--json", "log.toml"])
    assert done.exit_code == 0 and json.loads(done.stdout)["plan"] == [], done.output


@pytest.mark.usefixtures("undrawn")
def test_python_takes_a_path_before_or_after_the_plant_and_answers_as_the_command(folder: Path):
    answer = json.loads(call("log.csv", *FLAGS, "--scale", "level=1.5", "--json").stdout)
    plant = npred.plant("my_plant.py:Tank")
    how = {"columns": {"q": "Q1", "h": "level"}, "scale": {"level": 1.5}, "free": ["area", "outflow"]}
    first, second = npred.identify("log.csv", plant, **how), npred.identify(plant, folder / "log.csv", **how)
    assert first.D.tolist() == second.D.tolist() == answer["D"]
    assert first.parameters == second.parameters == answer["parameters"]
    assert first.sentences == answer["sentences"]


@pytest.mark.parametrize(
    ("arguments", "named", "words"),
    [
        (("log.csv",), {}, "expected a column for one of h, found time, Q1, level; map one by columns"),
        (("log.csv",), {"columns": {"Q": "Q1"}}, "got 'Q'; did you mean q?"),
        (("lok.csv",), {}, "expected a recording, found no file"),
        (("log.csv", [0.0]), {}, "identify: expected the path of a recording, or t, U and X, got both"),
        (([0.0, 1.0], [0.0, 1.0]), {}, "identify: expected the path of a recording, or t, U and X, got no X"),
    ],
)
def test_python_says_what_is_wrong_with_a_path(arguments: tuple, named: dict, words: str):
    with pytest.raises(ConfigError) as caught:
        npred.identify(npred.plant("my_plant.py:Tank"), *arguments, **named)
    assert words in str(caught.value)


def test_a_plant_that_declares_its_delay_is_refused_with_a_file_too(folder: Path):
    late = PLANT.replace("    def kappa", "    def delay(x, t, p, M):\n        return 0.3\n\n    def kappa")
    (folder / "my_plant.py").write_text(late)
    done = call("log.csv", *FLAGS, "-q")
    assert done.exit_code == 2 and "expected a plant whose delay is unknown" in done.output
