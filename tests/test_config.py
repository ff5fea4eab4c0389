"""The pipeline file: what is accepted, and one clear line for what is not."""

import math
import os
import re
import tomllib
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from npred.base.errors import ConfigError
from npred.lab import config
from npred.lab.config import dumps
from npred.lab.config.file import _leaves, put
from npred.loop.measurement import Sensors

PIPELINES = sorted((Path(__file__).parent.parent / "pipeline").glob("*.toml"))


@pytest.fixture
def empty(tmp_path: Path) -> Path:
    path = tmp_path / "empty.toml"
    path.write_text('plant = "activator_repressor"')
    return path


@pytest.mark.parametrize("path", PIPELINES, ids=lambda path: path.stem)
def test_the_pipelines_in_the_repository_load_and_are_named_after_their_file(path: Path):
    assert config.load(path).name == path.stem


def test_an_empty_file_is_the_defaults(empty: Path):
    assert config.load(empty) == config.Pipeline(plant="activator_repressor")


def test_a_pipeline_says_which_plant(tmp_path: Path):
    path = tmp_path / "p.toml"
    path.touch()
    with pytest.raises(ConfigError, match="plant: expected a value, got none; write it"):
        config.load(path)


KEYS = sorted({*_leaves(), *(key.rpartition(".")[0] for key in _leaves() if "." in key)})
NASTY = st.one_of(
    st.sampled_from(["1.0", "x", True, None, -1, 0, 1.5, 10**30, math.inf, math.nan, "a\nb", "a" * 200]),
    st.recursive(st.sampled_from([-1, "a", {}]), lambda each: st.lists(each, max_size=3), max_leaves=4),
    st.dictionaries(st.sampled_from(["a", "kind", "b\nc", "d-e"]), st.sampled_from([0, "a", []]), max_size=2),
)


@given(key=st.sampled_from(KEYS), value=NASTY)
@settings(max_examples=400)
def test_any_wrong_value_is_answered_in_one_line_of_npreds_own_words(key: str, value: Any):
    """Never with pydantic's, and never with a failure of what reads it: a key, what was expected, what came, a cure."""
    tables = {"plant": "scalar", "evaluate": {"X0": [1.0]}}
    try:
        put(tables, key, value)
        config.parse(tables, "p.toml")
    except ConfigError as error:
        said = str(error)
        assert re.match(r"p\.toml: [^\s:]+:( [\w, ]+:)? (expected .+, got .+; .+|unknown key)", said), said
        assert not re.search(r"Input|Field|[Vv]alid|instance|Value error|\n", said.replace(repr(value), "")), said


@pytest.mark.parametrize("key", ["X0", "test_share", "explore", "redraw", "weight_decay", "dx", "c", "input_bounds"])
def test_a_number_in_quotes_is_no_number(key: str):
    tables = {
        "X0": {"evaluate": {"X0": ["1.0"]}}, "weight_decay": {"train": {"fno": {"weight_decay": "0.1"}}},
        "dx": {"bench": {"dx": ["0.1"]}}, "c": {"parameters": {"c": "1.0"}},
        "input_bounds": {"evaluate": {"input_bounds": [["0", "1"]]}},
    }  # fmt: skip
    table = tables.get(key, {"generate": {key: "0.1"}})
    with pytest.raises(ConfigError, match=rf"{key}.*: expected a number, got '.*'; write one, without quotes"):
        config.parse({"plant": "scalar"} | table, "p.toml")


@pytest.mark.parametrize(
    ("u0", "said"),
    [
        ("foo", "evaluate.u0: expected a number or a list or 'equilibrium' or 'law', got 'foo'; write one of these"),
        ("laws", "got 'laws'; did you mean law?"),
        ([[1.0, "a"]], "evaluate.u0[0][1]: expected a number, got 'a'; write one, without quotes"),
        ([1.0, "a"], "evaluate.u0[1]: expected a number or a list, got 'a'; write one of these"),
    ],
)
def test_a_value_that_may_be_of_several_types_is_told_what_all_of_them_are(u0: Any, said: str):
    with pytest.raises(ConfigError) as caught:
        config.parse({"plant": "scalar", "evaluate": {"u0": u0}}, "p.toml")
    assert str(caught.value).endswith(said)


def test_a_misspelt_table_comes_before_what_is_wrong_without_it():
    """[evalute] has the actuator without which the table below it, rightly spelt, is refused."""
    tables = {"plant": "scalar", "evalute": {"actuator": "history"}, "evaluate": {"observer": {"kind": "ekf"}}}
    with pytest.raises(ConfigError, match=r"p.toml: evalute: unknown key; .*did you mean evaluate\?"):
        config.parse(tables, "p.toml")


def test_files_lie_relative_to_the_pipeline_and_those_of_overrides_relative_to_the_current_folder(tmp_path: Path):
    path = tmp_path / "sub" / "p.toml"
    path.parent.mkdir()
    path.write_text('plant = "a.py:A"\n[generate]\ndata = "d.h5"\n[evaluate]\nadaptation = "../law.py:Law"\n')
    found = config.load(path)
    assert found.plant == f"{path.parent / 'a.py'}:A"
    assert found.generate.data == str(path.parent / "d.h5")
    assert found.evaluate.adaptation == f"{path.parent / '../law.py'}:Law"
    assert found.generate.adaptation == config.PAPER
    assert config.load(path, ["plant=b.py:B"]).plant == "b.py:B"
    path.write_text(f'plant = "{tmp_path}/c.py:C"\n')
    assert config.load(path).plant == f"{tmp_path}/c.py:C"


def test_beside_the_files_that_it_names_a_pipeline_gives_their_names_alone(tmp_path: Path, empty: Path):
    path = tmp_path / "p.toml"
    path.write_text('plant = "sub/a.py:A"\n[generate]\ndata = "d.h5"\n[evaluate]\nadaptation = "../law.py:Law"\n')
    found = config.load(path)
    assert found.files == ["a.py", "d.h5", "law.py"]
    bare = found.with_file_names()
    assert (bare.plant, bare.generate.data, bare.evaluate.adaptation) == ("a.py:A", "d.h5", "law.py:Law")
    named = config.load(empty)
    assert (named.with_file_names(), named.files) == (named, [])


def test_overrides_reach_nested_keys_in_their_toml_type(empty: Path):
    overrides = ["train.deeponet.epochs=5", "generate.D=[0.5, 2]", "plant=scalar", "parameters.a=-1.5", "name='x-y'"]
    found = config.load(empty, overrides)
    assert found.train.deeponet.epochs == 5
    assert found.generate.D == (0.5, 2.0)
    assert (found.plant, found.parameters, found.name) == ("scalar", {"a": -1.5}, "x-y")


def test_a_later_override_wins_and_the_rest_of_its_table_stays(tmp_path: Path):
    path = tmp_path / "p.toml"
    path.write_text('plant = "scalar"\n[generate]\nsamples = 7\nrollouts = 3\n')
    found = config.load(path, ["generate.samples=8", "generate.samples=9"]).generate
    assert (found.samples, found.rollouts) == (9, 3)


def test_a_pipeline_is_frozen(empty: Path):
    with pytest.raises(ValueError, match="frozen"):
        config.load(empty).seed = 3


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("generate.smaples=3", ["generate.smaples", "unknown key", "samples"]),
        ("generate.smaples=3", ["generate.smaples", "did you mean samples?"]),
        ("gamma=3", ["gamma", "did you mean generate.gamma or evaluate.gamma?"]),
        ("train.width=3", ["train.width", "did you mean train.deeponet.width or train.fno.width?"]),
        ("evalaute.dt=3", ["evalaute", "unknown key", "did you mean evaluate?"]),
        ("foo=3", ["foo", "unknown key", "generate"]),
        ("train.deeponet.modes=3", ["train.deeponet.modes", "unknown key", "width"]),
        ("generate.samples=many", ["generate.samples", "whole number", "'many'"]),
        ("generate.samples=0", ["generate.samples", "1", "0"]),
        ("generate.dt=-0.1", ["generate.dt", "a number above 0", "-0.1"]),
        ("generate.dt=nan", ["generate.dt", "finite", "nan"]),
        ("generate.dt=1e3", ["generate.dt", "t_end", "1000"]),
        ("generate.adaptation=none", ["generate.adaptation", "frozen, or a class of a file", "'none'"]),
        ("generate.nx=1", ["generate.nx", "2", "1"]),
        ("bench.dx=[-0.01]", ["bench.dx[0]", "a number above 0", "-0.01"]),
        ("generate.bounds=[2, 1]", ["generate", "bounds", "low <= high", "[2.0, 1.0]"]),
        ("generate.u0=warm", ["generate.u0", "number", "'equilibrium' or 'law'", "'warm'"]),
        ("generate.u0=nan", ["generate.u0", "finite", "nan"]),
        ("generate={bounds=[0.1, 1.5], D_hat=[[1.0, 2.0]]}", ["generate", "D_hat[0]", "[1.0, 2.0]", "[0.1, 1.5]"]),
        ("evaluate={bounds=[0.1, 4.0], D=9}", ["evaluate.D: expected within bounds = [0.1, 4.0], got 9;"]),
        ("evaluate.bounds=[1.5, 4]", ["evaluate.D: expected within bounds = [1.5, 4.0], got 1;"]),
        (
            "generate={bounds=[0.1, 4.0], D=[0.05, 1]}",
            ["generate.D: expected within bounds = [0.1, 4.0], got [0.05, 1.0]"],
        ),
        ("train.fno.nodes=40", ["train.fno.nodes", "generate.nx - 1 = 100, got 40", "2, 3, 5, 6, 11, 21, 26, 51, 101"]),
        ("evaluate={bounds=[0.1, 4.0], D_hat=9}", ["evaluate", "D_hat", "9", "[0.1, 4.0]"]),
        ("evaluate={bounds=[0.1, 4.0], case_D_hat=[1, 9]}", ["evaluate", "case_D_hat[1]", "9", "[0.1, 4.0]"]),
        ("generate.rollouts=1", ["generate", "rollouts", "at least 2", "1"]),
        ("generate.D=[2, 1]", ["generate", "D:", "low <= high", "[2.0, 1.0]"]),
        ("train.models=['cnn']", ["train.models", "expected one of deeponet, fno", "table [train.NAME]", "'cnn'"]),
        ("train.fno.snapshots=[9999]", ["train.fno", "snapshots", "9999"]),
        ("train.fno={eps=0.1, snapshots=[2]}", ["train.fno", "snapshots: expected none beside eps"]),
        ("generate=3", ["generate", "3"]),
        ("name='../away'", ["name: expected", "letters, digits", "'../away'"]),
        ("name=.hidden", ["name: expected", "a letter or digit first"]),
        (f"name={'n' * 101}", ["name: expected up to 100"]),
        ("seed.x.y=3", ["seed", "3"]),
        ("seed=true", ["seed", "whole number", "True"]),
        ("generate.t_end=true", ["generate.t_end", "number", "True"]),
        ("generate.nx='5'", ["generate.nx", "whole number", "'5'"]),
        ("generate.nx=1e22", ["generate.nx", "whole number"]),
        ("generate.dt=1e-308", ["generate", "t_end: expected at most 1000000000 steps", "lengthen dt"]),
        ("evaluate.t_end=1e308", ["evaluate", "t_end: expected at most 1000000000 steps"]),
        ("seed", ["--set", "key.path=value", "'seed'"]),
        ("=3", ["--set", "key.path=value", "'=3'"]),
    ],
)
def test_a_bad_value_is_one_line_that_names_key_expectation_and_value(empty: Path, override: str, words: list[str]):
    with pytest.raises(ConfigError) as caught:
        config.load(empty, [override])
    message = str(caught.value)
    assert "\n" not in message
    assert [word for word in words if word not in message] == []


@pytest.mark.parametrize("keys", [{"train": {"fno": {"nodes": 51}}}, {"evaluate": {"adaptation": "frozen", "D": 9.0}}])
def test_a_divisor_of_the_grid_and_a_known_delay_are_accepted(keys):
    config.parse({"plant": "scalar"} | keys, "tests")


def test_nodes_are_of_the_grid_of_the_data(empty: Path):
    assert config.load(empty, ["generate.nx=41", "train.fno.nodes=21"]).train.fno.nodes == 21
    unused = ["train.fno.nodes=40", 'train.models=["deeponet"]']
    assert config.load(empty, unused).train.fno.nodes == 40, "a network that is not trained"
    assert config.load(empty, ["train.fno.nodes=40", "generate.data=d.h5"]).train.fno.nodes == 40, "another grid"


def test_an_override_below_a_plain_value_is_refused(tmp_path: Path):
    path = tmp_path / "p.toml"
    path.write_text("seed = 3\n")
    with pytest.raises(ConfigError, match="expected a table at 'seed', got 3"):
        config.load(path, ["seed.x=1"])


def test_a_plant_in_place_of_a_pipeline_is_told_where_it_goes(tmp_path: Path):
    path = tmp_path / "my_plant.py"
    path.write_text("class Tank:\n    pass\n")
    with pytest.raises(
        ConfigError, match=r"my_plant\.py: expected a pipeline, a TOML file, got code; write plant = .*:Tank"
    ):
        config.load(path)


@pytest.mark.parametrize(("content", "word"), [(b"[generate\n", "line 1"), (b"\xff\xfe", "TOML")])
def test_a_file_that_is_no_toml_is_named(tmp_path: Path, content: bytes, word: str):
    path = tmp_path / "p.toml"
    path.write_bytes(content)
    with pytest.raises(ConfigError, match=word) as caught:
        config.load(path)
    assert str(path) in str(caught.value)


def test_a_missing_file_and_a_folder_are_named(tmp_path: Path):
    for path in (tmp_path / "none.toml", tmp_path):
        with pytest.raises(ConfigError) as caught:
            config.load(path)
        assert str(path) in str(caught.value)


def test_a_pipe_that_nobody_writes_to_is_not_waited_for(tmp_path: Path):
    os.mkfifo(tmp_path / "p.toml")
    with pytest.raises(ConfigError, match=r"p\.toml: expected a TOML file, got: a pipe that nobody writes to"):
        config.load(tmp_path / "p.toml")


def test_a_pipe_whose_writer_takes_its_time_is_read_to_its_end(tmp_path: Path):
    reading, writing = os.pipe()
    with ThreadPoolExecutor(1) as pool:
        loaded = pool.submit(config.load, Path(f"/dev/fd/{reading}"))
        for part in (b'plant = "sca', b'lar"\n' + b"#" * 200_000):  # more than a pipe holds
            os.write(writing, part[:60_000])
            for rest in range(60_000, len(part), 60_000):
                os.write(writing, part[rest : rest + 60_000])
        os.close(writing)
        assert loaded.result().plant == "scalar"
    os.close(reading)


def test_a_device_without_an_end_is_not_read_to_it():
    with pytest.raises(ConfigError, match="more than 1048576 bytes"):
        config.load(Path("/dev/zero"))


def test_a_run_without_an_end_is_refused_with_its_size(tmp_path: Path, empty: Path):
    said = "generate.t_end: expected at most 1000000000 steps, got 2e\\+14 steps of 0.005, whose record takes 9.6 PB"
    with pytest.raises(ConfigError, match=said):
        config.load(empty, ["generate.t_end=1e12"])


SCENARIOS = """
plant = "scalar"
[evaluate]
measurement = { relative_noise = 0.01, period = 0.05 }
[[evaluate.scenarios]]
name = "noise"
measurement = { relative_noise = 0.03, period = 0.05 }
[[evaluate.scenarios]]
name = "errors"
measurement = { noise = 0.1, bias = [-0.2], resolution = [0.5] }
[[evaluate.scenarios]]
name = "drift"
drift = { amplitude = 0.3, period = 60.0 }
adaptation = "law.py:Law"
case_D_hat = [0.5]
case_t_end = 20.0
"""


def test_a_scenario_takes_the_place_of_the_keys_that_it_gives(tmp_path: Path):
    path = tmp_path / "p.toml"
    path.write_text(SCENARIOS)
    evaluate = config.load(path).evaluate
    noise, errors, drift = (evaluate.under(scenario) for scenario in evaluate.scenarios)
    assert noise.measurement == Sensors(relative_noise=0.03, period=0.05)
    sensors = {"noise": 0.1, "bias": [-0.2], "resolution": [0.5]}
    assert errors.measurement == Sensors(**sensors)
    assert noise == evaluate.model_copy(update={"measurement": noise.measurement})
    assert (drift.adaptation, drift.case_D_hat, drift.case_t_end) == (f"{tmp_path / 'law.py'}:Law", [0.5], 20.0)
    assert drift.measurement == evaluate.measurement
    assert config.load(path).files == ["law.py"]


def test_a_dump_holds_all_keys_and_reads_back(empty: Path):
    some = config.load(
        empty, ["evaluate.actuator=history", 'evaluate.scenarios=[{name="a", measurement={relative_noise=0.1}}]']
    )
    dump = some.model_dump()
    assert set(dump["evaluate"]) == set(config.Evaluate.model_fields)
    assert set(dump["evaluate"]["scenarios"][0]) == set(config.Scenario.model_fields)
    assert config.parse(dump, "dump") == config.parse(tomllib.loads(dumps(dump)), "page") == some


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("evaluate.scenarios=[{truth_scale=1.1}]", ["scenarios[0].name: expected a value, got none"]),
        ('evaluate.scenarios=[{name="a", measurement={nois=0.1}}]', ["scenarios[0].measurement.nois: unknown key"]),
        ('evaluate.scenarios=[{name="a"}, {name="a"}]', ["expected different names, got 'a' twice; rename one"]),
        ('evaluate.scenarios=[{name="a", drift={amplitude=0.1}}]', ["drift.period: expected a value, got none"]),
        ('evaluate.scenarios=[{name="a", drift={amplitude=1.5, period=9.0}}]', ["at least 0, got -0.5; shrink it"]),
        ('evaluate.scenarios=[{name="a", jump={to=9.0, at=1.0}}]', ["scenarios[0]: delay: expected within bounds"]),
        ('evaluate.scenarios=[{name="a", case_t_end=1e-3}]', ["scenarios[0]: dt: expected at most case_t_end = 0.001"]),
        ('evaluate.scenarios=[{name="a", case_t_end=1e9}]', ["scenarios[0]: case_t_end: expected at most 10"]),
        ("evaluate.case_t_end=1e9", ["case_t_end: expected at most 1000000000 steps", "shorten case_t_end"]),
        ("evaluate.measurement.jitter=0.1", ["measurement: expected a period that jitter spreads, got none; give"]),
        ('evaluate.scenarios=[{name="a", measurement={jitter=0.1}}]', ["measurement: expected a period"]),
        ('evaluate.scenarios=[{name="a", case_D_hat=[9.0]}]', ["scenarios[0].case_D_hat: expected within bounds"]),
        ('evaluate.scenarios=[{name="a", drift={amplitude=0.1, period=9.0}, jump={to=1.1, at=1.0}}]',
         ["drift, jump: expected one of them, got both"]),
        ('evaluate.scenarios=[{name="a", adaptation="observer"}]', ["scenarios[0].adaptation: expected bresch"]),
        ("generate.actuator=guessed", ["generate.actuator: expected 'measured' or 'history', got 'guessed'"]),
        ("generate.measurement.relative_noise=-0.1", ["expected relative_noise of at least 0, got -0.1; give"]),
        ("generate.measurement.noise=[0.1, -0.1]", ["generate.measurement: expected noise of at least 0"]),
        ("generate.measurement.bias=[nan]", ["generate.measurement: bias: expected finite numbers, got nan"]),
        ("generate.measurement.drop=1.0", ["generate.measurement: expected drop from 0 up to 1, not included, got 1"]),
        ("evaluate.timing.jitter=0.1", ['timing: expected actuator="history", got \'measured\'']),
        ("evaluate.observer.kind=kalman", ["evaluate.observer.kind: expected ekf, luenberger, or a class of a file"]),
        ('evaluate.scenarios=[{name="a", timing={lost=0.1}}]', ["scenarios[0]: timing: expected actuator"]),
        ('evaluate.scenarios=[{name="a", actuator="history", timing={stop=0.1}}]', ["expected 0 < stop < stop_every"]),
        ("generate.measurement.nois=0.1", ["unknown key; expected one of bias, delay, drop, jitter, noise"]),
    ],
)  # fmt: skip
def test_a_scenario_or_a_sensor_that_makes_no_sense_is_one_line(empty: Path, override: str, words: list[str]):
    with pytest.raises(ConfigError) as error:
        config.load(empty, [override])
    assert all(word in str(error.value) for word in words), str(error.value)
    assert "\n" not in str(error.value)


DEFAULTS = {"D_hat", "case_D_hat", "explore_D", "explore_D_hat", "bounds", "dt", "t_end", "case_t_end"}


def test_what_is_left_out_follows_the_delay():
    at = config.parse({"plant": "scalar", "evaluate": {"D": 0.12}, "generate": {"D": [0.1, 0.3]}}, "tests")
    table, data = at.evaluate, at.generate
    assert (table.D_hat, table.bounds) == (0.24, pytest.approx((0.012, 0.48)))
    assert table.case_D_hat == pytest.approx([0.036, 0.06, 0.12, 0.18, 0.24])
    assert (data.D_hat[0], data.bounds) == (pytest.approx((0.06, 0.14)), pytest.approx((0.02, 0.8)))
    assert (data.explore_D, data.explore_D_hat) == (pytest.approx((0.05, 0.4)), pytest.approx((0.05, 0.7)))
    assert (table.dt, table.t_end, table.case_t_end) == (0.0005, 4.8, 4.8)


def test_steps_and_loops_are_as_long_as_the_delay_asks():
    short = config.parse({"plant": "scalar", "evaluate": {"D": 0.02}}, "tests").evaluate
    long = config.parse({"plant": "scalar", "evaluate": {"D": 5.0}, "generate": {"D": 5.0}}, "tests")
    assert (short.dt, short.t_end) == (5e-05, 0.8)
    assert (long.evaluate.t_end, long.evaluate.case_t_end, long.generate.t_end) == (200.0, 200.0, 200.0)


@pytest.mark.parametrize("D", [0.004, 0.12, 9.0])
def test_no_delay_is_refused_for_a_key_that_nobody_wrote(D):
    """evaluate.case_D_hat[1] was refused, where only D was given."""
    config.parse({"plant": "scalar", "evaluate": {"D": D}, "generate": {"D": D, "explore": 0.5}}, "tests")


def test_bounds_hold_what_is_given_and_estimates_stay_within_given_bounds():
    tables = {
        "generate": {"D_hat": [[0.01, 9.0]]},
        "evaluate": {"bounds": [0.5, 1.6], "map_D": [1.5], "map_D_hat": [1]},
    }
    at = config.parse({"plant": "scalar"} | tables, "tests")
    assert at.generate.bounds == (0.01, 9.0)
    assert (at.evaluate.D_hat, at.evaluate.case_D_hat) == (1.6, [0.5, 0.5, 1.0, 1.5, 1.6])


@pytest.mark.parametrize("path", PIPELINES, ids=lambda path: path.stem)
def test_the_pipelines_of_npred_depend_on_no_default_that_follows_the_delay(path: Path):
    """Their results were made when the defaults were those of D = 1 s."""
    pipeline, written = config.load(path), tomllib.loads(path.read_text(encoding="utf-8"))
    for stage in ("generate", "evaluate"):
        table = getattr(pipeline, stage)
        plain = {key: field.default for key, field in type(table).model_fields.items() if key in DEFAULTS}
        expected = type(table)(**(plain | written.get(stage, {})))
        assert table.model_dump() == expected.model_dump()
