"""The runner with stages that take no time: what runs, what does not, and why."""

import itertools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import fake_stages
import pytest
from conftest import settings_of

from npred.base.errors import ConfigError, StoreError
from npred.lab import config
from npred.lab.report.terminal.console import Console
from npred.lab.scheduler.models import load_model
from npred.lab.scheduler.plan import STAGES, Planner, nodes, usual
from npred.lab.scheduler.runner import Outcome, Runner
from npred.lab.store import Store

Run = Callable[..., list[Outcome]]
ALL = ("generate", "deeponet", "fno", "evaluate", "bench", "report")


def planner(pipeline: Path, *overrides: str, device: str = "cpu", force: tuple[str, ...] = ()) -> Planner:
    store = Store(pipeline.parent / "store")
    return Planner(config.load(pipeline, list(overrides)), store, device, frozenset(force))


@pytest.fixture
def run(fakes: Path, pipeline: Path) -> Run:
    """Run the pipeline file with overrides; all stages, unless told."""

    def call(*overrides: str, targets: tuple[str, ...] = (), only: str | None = None, **options: Any):
        plan = planner(pipeline, *overrides, **options)
        return Runner(Console(quiet=True), jobs=1).run(plan, nodes(plan.config, targets or usual(plan.config), only))

    return call


def ran(outcomes: list[Outcome]) -> list[str]:
    return [outcome.node.name for outcome in outcomes if outcome.action == "run"]


def reasons(outcomes: list[Outcome]) -> dict[str, str]:
    return {outcome.node.name: outcome.reason for outcome in outcomes}


def plan(pipeline: Path, *overrides: str) -> dict[str, str]:
    planned = planner(pipeline, *overrides)
    return {step.node.name: step.reason for step in planned.plan(nodes(planned.config, usual(planned.config)))}


def bytes_of(root: Path) -> dict[str, tuple[bytes, int]]:
    return {str(p): (p.read_bytes(), p.stat().st_mtime_ns) for p in root.glob("[!.]*/**/*") if p.is_file()}


def test_the_second_run_runs_nothing_and_touches_nothing(run: Run, fakes: Path, pipeline: Path):
    first = run()
    before = bytes_of(pipeline.parent / "store")
    second = run()
    assert (ran(first), ran(second)) == (list(ALL), [])
    assert len(fakes.read_text().splitlines()) == 6
    assert bytes_of(pipeline.parent / "store") == before
    assert [o.artifact.manifest.key for o in first] == [o.artifact.manifest.key for o in second]


def test_two_stores_get_the_same_bytes(run: Run, pipeline: Path, tmp_path: Path):
    """But for the manifests, which say when; their digests are of the files, and their keys are in the paths."""
    files = []
    for _ in range(2):
        made = {Path(p).relative_to(tmp_path): b for p, (b, _) in _run_afresh(run, pipeline).items()}
        files.append({path: content for path, content in made.items() if path.name != "manifest.json"})
    assert files[0] == files[1]


def _run_afresh(run: Run, pipeline: Path) -> dict[str, tuple[bytes, int]]:
    run()
    found = bytes_of(pipeline.parent / "store")
    (pipeline.parent / "store").rename(pipeline.parent / f"old{len(list(pipeline.parent.glob('old*')))}")
    return found


@pytest.mark.parametrize(
    ("override", "expected", "words"),
    [
        ("train.deeponet.epochs=40", ["deeponet", "evaluate", "bench", "report"], "train.deeponet.epochs: 30 -> 40"),
        ("train.fno.lr=0.5", ["fno", "report"], "train.fno.lr: 0.002 -> 0.5"),
        ("bench.calls=9", ["bench", "report"], "bench.calls: 1000 -> 9"),
        ("evaluate.X0=[1.0]", ["evaluate", "report"], "evaluate.X0: [0.5] -> [1.0]"),
        ("generate.rollouts=60", list(ALL), "generate.rollouts: 50 -> 60"),
        ("seed=1", list(ALL), "seed: 0 -> 1"),
        ("parameters.a=0.75", list(ALL), "plant.parameters.a: 0.5 -> 0.75"),
        ("train.models=['fno']", ["evaluate", "bench", "report"], 'train.models: ["deeponet", "fno"] -> ["fno"]'),
    ],
)
def test_a_change_reruns_what_depends_on_it_and_says_why(run: Run, override: str, expected: list[str], words: str):
    run()
    outcomes = run(override)
    assert ran(outcomes) == expected
    assert words in reasons(outcomes)[expected[0]]


def test_a_changed_input_is_the_reason_downstream(run: Run):
    before = {outcome.node.name: outcome.artifact.manifest.digest for outcome in run()}
    after = run("train.deeponet.epochs=40")
    digest = next(o.artifact.manifest.digest for o in after if o.node.name == "deeponet")
    assert reasons(after)["evaluate"] == f"input deeponet changed: {before['deeponet'][:12]} -> {digest[:12]}"


def test_an_equal_result_stops_the_reruns(run: Run):
    run()
    again = ran(run("generate.samples=4000"))  # the fake's data do not depend on samples; the report tells all settings
    assert again == ["generate", "report"]


def test_going_back_is_a_hit(run: Run):
    run()
    run("train.fno.epochs=2")
    assert ran(run()) == []


def test_a_new_stage_version_reruns_it(run: Run, monkeypatch: pytest.MonkeyPatch):
    run()
    table = dict(STAGES)
    version = table["train"].version
    fake_stages.install(table, train=version + 1)
    monkeypatch.setitem(STAGES, "train", table["train"])
    outcomes = run()
    assert ran(outcomes) == ["deeponet", "fno"]
    assert reasons(outcomes)["fno"] == f"stage version: {version} -> {version + 1}"


def test_force_reruns_the_named_stages_only(run: Run):
    run()
    outcomes = run(targets=("train",), force=("train",))
    assert ran(outcomes) == ["deeponet", "fno"]
    assert reasons(outcomes)["deeponet"] == "--force"
    assert ran(run()) == []  # the same bytes: nothing downstream follows


def test_only_one_network(run: Run):
    assert ran(run(targets=("train",), only="fno")) == ["generate", "fno"]
    assert ran(run(targets=("bench",))) == ["deeponet", "bench"]


def test_the_closest_earlier_result_gives_the_reason(run: Run, pipeline: Path):
    run("train.fno.epochs=3", "train.fno.width=5", targets=("train",))
    run("train.fno.epochs=4", targets=("train",))
    run("train.fno.lr=1.0", "train.fno.width=6", targets=("train",))
    assert plan(pipeline, "train.fno.epochs=5")["fno"] == "train.fno.epochs: 4 -> 5"
    run("train.fno.epochs=6", targets=("train",))  # as close, and more recent
    assert plan(pipeline, "train.fno.epochs=5")["fno"] == "train.fno.epochs: 6 -> 5"


def test_another_pipelines_results_give_hits_but_no_reasons(run: Run, pipeline: Path):
    run("name=other")
    assert ran(run()) == ["report"]  # which bears the pipeline's name
    assert plan(pipeline, "train.fno.epochs=5")["fno"] == "no result yet"


def test_many_differences_are_counted(run: Run, pipeline: Path):
    run(targets=("generate",))
    changed = [f"generate.{key}" for key in ("samples=9", "rollouts=2", "dt=0.1", "nx=5", "t_end=3.0", "gamma=2.0")]
    assert plan(pipeline, *changed)["generate"].endswith("; and 2 more")


def test_a_plan_says_what_waits_for_what_and_why(run: Run, pipeline: Path, fakes: Path):
    assert plan(pipeline)["fno"] == "no result yet"
    run()
    found = plan(pipeline, "generate.rollouts=60", "train.fno.epochs=5")
    cause = "generate runs first (generate.rollouts: 50 -> 60)"
    assert found["deeponet"] == found["bench"] == f"stale: {cause}"
    assert found["fno"] == f"stale: train.fno.epochs: 100 -> 5; {cause}"
    assert len(fakes.read_text().splitlines()) == 6


def test_a_corrupt_input_stops_the_run_before_the_stage(run: Run, fakes: Path):
    data = run(targets=("generate",))[0].artifact.folder / "data.bin"
    data.write_bytes(data.read_bytes()[:-1] + b"!")
    with pytest.raises(StoreError, match=r"data\.bin"):
        run(targets=("train",))
    assert fakes.read_text().splitlines() == ["generate::new"]
    assert ran(run(targets=("generate",), force=("generate",))) == ["generate"]
    assert ran(run(targets=("generate",))) == []


def test_a_corrupt_manifest_stops_the_plan_and_force_replaces_it(run: Run, pipeline: Path):
    folder = run(targets=("generate",))[0].artifact.folder
    (folder / "manifest.json").write_text("{}")
    with pytest.raises(StoreError, match=r"manifest\.json"):
        plan(pipeline)
    assert ran(run(targets=("generate",), force=("generate",))) == ["generate"]


def test_a_stage_that_fails_leaves_its_checkpoint_and_nothing_else(run: Run, fakes: Path, pipeline: Path, monkeypatch):
    real = fake_stages.ANSWERS["train"]
    monkeypatch.setitem(fake_stages.ANSWERS, "train", lambda job: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        run()
    store = Store(pipeline.parent / "store")
    assert [artifact.manifest.question.stage for artifact in store.artifacts()] == ["generate"]
    assert [path.parent.name for path in store.leftovers()] == [".scratch"]
    monkeypatch.setitem(fake_stages.ANSWERS, "train", real)
    assert ran(run()) == [*ALL[1:]]
    assert "train:deeponet:resumed" in fakes.read_text().splitlines()
    assert store.leftovers() == []


def test_a_stage_that_fails_without_a_checkpoint_leaves_nothing(run: Run, pipeline: Path, monkeypatch):
    def fails(job):
        (job.scratch / "checkpoint").unlink()
        raise ZeroDivisionError

    monkeypatch.setitem(fake_stages.ANSWERS, "generate", fails)
    with pytest.raises(ZeroDivisionError):
        run(targets=("generate",))
    store = Store(pipeline.parent / "store")
    assert store.leftovers() == [] and list((store.root / ".scratch").iterdir()) == []


def test_where_it_runs_enters_the_key_of_bench_only(pipeline: Path):
    made = planner(pipeline).config
    same = {n.name: settings_of(n, made) == settings_of(n, made, "cuda") for n in nodes(made, usual(made))}
    assert same == {"generate": True, "deeponet": True, "fno": True, "evaluate": True, "bench": False, "report": True}


def test_every_key_of_the_pipeline_file_enters_the_questions_that_it_should(pipeline: Path):
    made = planner(pipeline).config
    asked = {node.name: settings_of(node, made) for node in nodes(made, usual(made))}
    for section, names in {"generate": ["generate"], "evaluate": ["evaluate"], "bench": ["bench"]}.items():
        table = type(getattr(made, section))
        keys = set(table.model_fields)
        assert [name for name in asked if keys == set(asked[name].get(section, ()))] == names
    for model in ("deeponet", "fno"):
        assert set(asked[model]["train"]) == {model}
        assert set(asked[model]["train"][model]) == set(type(getattr(made.train, model)).model_fields)


MOVER = """
class Mover:
    states, inputs, box = ("x", "y"), ("U",), {"y": (0, 1)}
    def f(x, u, t, p, M): return [u.U, -x.y]
    def kappa(x, t, p, M): return [-x.x]
    def V(x, t, p, M): return x.x**2
"""


def test_ranges_of_the_pipeline_enter_where_data_were_given_and_the_plant_has_none(tmp_path: Path, pipeline: Path):
    (tmp_path / "mover.py").write_text(MOVER)
    (tmp_path / "d.h5").write_bytes(b"samples")

    def asked(name: str, *more: str) -> dict[str, Any]:
        gains = ("generate.gamma=1", "evaluate.gamma=1")  # none is derived for a plant without a box
        made = planner(pipeline, f"plant={tmp_path}/mover.py:Mover", *gains, *more).config
        return next(settings_of(node, made) for node in nodes(made, usual(made)) if node.name == name)

    given = f"generate.data={tmp_path}/d.h5"
    for name in ("evaluate", "bench"):
        near = asked(name, given, "generate.box={x = [0, 1]}")
        assert near != asked(name, given, "generate.box={x = [0, 2]}")
        assert near == asked(name, given, "generate.box={x = [0, 1], y = [0, 9]}"), "the plant has a range of its own"
        assert asked(name, "generate.box={x = [0, 1]}") == asked(name), "the data's digest tells simulated ones apart"
    assert asked("deeponet", given, "generate.box={x = [0, 1]}") == asked("deeponet")


def test_where_files_lie_enters_no_key(pipeline: Path, monkeypatch: pytest.MonkeyPatch):
    folder = pipeline.parent
    (folder / "mover.py").write_text(MOVER)
    (folder / "d.h5").write_bytes(b"samples")
    tables = '[generate]\ndata = "d.h5"\nbox = { x = [0, 1] }\n[evaluate]\ngamma = 1.0\n'
    pipeline.write_text(f'plant = "mover.py:Mover"\n{tables}')
    monkeypatch.chdir(folder)
    here, there = config.load(Path(pipeline.name)), config.load(pipeline)
    assert here != there
    for node in nodes(here, usual(here)):
        assert settings_of(node, here) == settings_of(node, there)


def test_the_order_of_the_networks_does_not_matter(pipeline: Path):
    for order in itertools.permutations(["deeponet", "fno", "fno"]):
        made = planner(pipeline, f"train.models={list(order)}").config
        assert [node.name for node in nodes(made, usual(made))] == list(ALL)


def test_a_bound_at_infinity_can_enter_a_key(run: Run):
    assert "generate" in ran(run("generate.input_bounds=[[0.0, inf]]", targets=("generate",)))


def test_the_job_gets_its_inputs_by_name(run: Run, monkeypatch: pytest.MonkeyPatch):
    seen = {}
    for name, answer in fake_stages.ANSWERS.items():
        monkeypatch.setitem(
            fake_stages.ANSWERS, name, lambda job, answer=answer, name=name: seen.setdefault(name, job) and answer(job)
        )
    outcomes = {outcome.node.name: outcome.artifact.folder for outcome in run()}
    assert seen["generate"].inputs == {}
    assert seen["train"].inputs == {"generate": outcomes["generate"]}
    assert seen["evaluate"].inputs == {name: outcomes[name] for name in ("generate", "deeponet", "fno")}
    assert (seen["train"].model, seen["bench"].model, seen["train"].plant.name) == ("deeponet", None, "scalar")


@pytest.fixture
def trained(run: Run, pipeline: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Path]:
    """The folders of a run whose networks have a snapshot of epoch 7."""
    real = fake_stages.ANSWERS["train"]

    def train(job: Any) -> dict[str, Any]:
        (job.folder / "snapshot-7.safetensors").write_text("weights")
        return real(job)

    monkeypatch.setitem(fake_stages.ANSWERS, "train", train)
    monkeypatch.setenv("NPRED_STORE", str(pipeline.parent / "store"))
    return {outcome.node.name: outcome.artifact.folder for outcome in run(targets=("train",))}


def test_models_are_found_by_pipeline_folder_and_key(trained: dict[str, Path], pipeline: Path, monkeypatch):
    folder = trained["deeponet"]
    (pipeline.parent / "pipeline").mkdir()
    (pipeline.parent / "pipeline" / "paper.toml").write_bytes(pipeline.read_bytes())
    monkeypatch.chdir(pipeline.parent)
    for spec in (f"{pipeline}:deeponet", "deeponet", str(folder), folder.name[:10], f"train/{folder.name}"):
        assert load_model(spec)[:3] == (folder, "deeponet", None)
        assert load_model(f"{spec}@7")[:3] == (folder, "deeponet", 7)
    assert load_model(f"{pipeline}:fno").folder == trained["fno"]


@pytest.mark.parametrize(
    ("spec", "words"),
    [
        ("{p}:deeponet@8", "snapshot of epoch 8"),
        ("{p}:deeponet@best", "epoch after @"),
        ("{p}:cnn", "after the colon: expected one of deeponet, fno, "),
        ("{generate}", "expected a trained model"),
        ("0123456789", "expected one artifact"),
        ("nowhere.toml:fno", "nowhere.toml"),
    ],
)
def test_a_model_that_is_not_there_is_one_line(trained: dict[str, Path], pipeline: Path, spec: str, words: str):
    with pytest.raises(ConfigError, match=words):
        load_model(spec.format(p=pipeline, generate=trained["generate"]))


def test_an_untrained_model_names_the_command(fakes: Path, pipeline: Path):
    with pytest.raises(ConfigError, match=f"npred train {pipeline} --model fno"):
        load_model(f"{pipeline}:fno", pipeline.parent / "store")


def test_corrupt_weights_are_not_loaded(trained: dict[str, Path], pipeline: Path):
    (trained["fno"] / "data.bin").write_bytes(b"")
    with pytest.raises(StoreError, match=r"data\.bin"):
        load_model(f"{pipeline}:fno")


def test_labels_and_units_enter_the_keys_of_what_draws_them_and_no_other():
    cart = config.parse({"plant": "cart_pole", "generate": {"D": 0.2}, "evaluate": {"D": 0.2}}, "test")
    named = {node.title for node in nodes(cart, usual(cart)) if "labels" in str(settings_of(node, cart))}
    assert named == {"evaluate", "report"}
