"""Laws for the delay estimate: in Python and compiled; of npred, of a package, of a file; in keys."""

from pathlib import Path

import numpy as np
import pytest
from conftest import settings_of
from input_histories import at_nodes
from jobs import job, tables

import npred
from npred import plants
from npred.base.errors import ConfigError
from npred.estimation import delay_law
from npred.estimation.adaptation import DelayAdaptation
from npred.lab import config
from npred.lab.config import conditions
from npred.lab.scheduler.plan import Node
from npred.lab.stages.generate import generate
from npred.lab.training.data.dataset import Dataset
from npred.prediction.methods import RK4

PLANT = npred.plant("scalar")
LOOP = {"D": 1.0, "D_hat": [1.6, 0.7], "X0": [[1.0], [0.5]], "t_end": 3.0, "dt": 0.01}


class Towards(npred.DelayLaw):
    """D_hat' = gamma (1 - D_hat)."""

    def rate(self, plant, X, u, P, D_hat, t):
        return self.gamma * (1.0 - D_hat)


class Leaky(npred.DelayAdaptation):
    """The paper's law and a leak towards 1 s."""

    def rate(self, plant, X, u, P, D_hat, t):
        return super().rate(plant, X, u, P, D_hat, t) - 0.5 * (D_hat - 1.0)


class Same(npred.DelayAdaptation):
    """The paper's law, in Python."""

    def rate(self, plant, X, u, P, D_hat, t):
        return super().rate(plant, X, u, P, D_hat, t)


def loops(law, **changes):
    return npred.simulate(PLANT, RK4(PLANT, 51), adaptation=law, **LOOP | changes)


@pytest.mark.parametrize(
    ("name", "law"),
    [
        ("bresch-pietri-krstic", npred.DelayAdaptation()), ("l1", npred.L1Adaptation()),
        ("delay-observer", npred.DelayObserver()), ("frozen", None),
    ],
)  # fmt: skip
def test_a_law_has_a_name_in_python_too(name, law):
    np.testing.assert_array_equal(loops(name).D_hat, loops(law).D_hat)
    bounded = {"D_hat": 0.7, "actuator": "history"}
    named, made = (npred.controller(PLANT, RK4(PLANT, 11), each, 0.01, **bounded) for each in (name, law))
    assert named.adaptation == made.adaptation


def test_an_unknown_name_of_a_law_is_told():
    with pytest.raises(ConfigError, match=r"adaptation: expected .*frozen, or a class .*did you mean delay-observer"):
        loops("delay-observr")


def test_the_estimate_follows_the_rate():
    """D_hat' = gamma (1 - D_hat) in closed form: the error falls with the square of dt."""
    errors = []
    for dt in (0.01, 0.005):
        estimates = loops(Towards(gamma=2.0), dt=dt).D_hat
        exact = 1.0 + np.array([[0.6], [-0.3]]) * np.exp(-2.0 * dt * np.arange(estimates.shape[-1]))
        errors.append(np.abs(estimates - exact).max())
    assert errors[0] < 2e-4
    assert errors[1] / errors[0] == pytest.approx(0.25, abs=0.03)


def test_the_estimate_stays_within_the_bounds():
    found = loops(Towards(gamma=2.0, bounds=(0.5, 0.9)), D_hat=0.6).D_hat
    assert found.max() == 0.9 and (np.diff(found) >= 0).all()


def test_the_papers_law_is_the_same_in_python():
    settings = {"gamma": 3.0, "b": 0.5, "bounds": (0.2, 3.0)}
    compiled, interpreted = loops(npred.DelayAdaptation(**settings)), loops(Same(**settings))
    np.testing.assert_allclose(interpreted.D_hat, compiled.D_hat, rtol=1e-12)
    np.testing.assert_allclose(interpreted.X, compiled.X, rtol=1e-10, atol=1e-13)
    assert np.isfinite(compiled.N).all() and np.isnan(interpreted.N).all()


def test_a_law_may_extend_the_papers():
    found = loops(Leaky(gamma=1.0), t_end=20.0).D_hat[:, -1]
    np.testing.assert_allclose(found, 1.0, atol=1e-3)


def test_a_law_may_replace_phi():
    class Still(npred.DelayAdaptation):
        def phi(self, plant, X, u, P, D_hat, t=0.0):
            return np.zeros(len(D_hat))

    run = loops(Still(gamma=1000.0))
    np.testing.assert_array_equal(run.D_hat, np.broadcast_to(run.D_hat[..., :1], run.D_hat.shape))


def test_the_controller_takes_the_same_steps():
    law = Leaky(gamma=2.0)
    loop = loops(law, D_hat=1.6, X0=[1.0], samples=np.arange(300))
    controller = npred.controller(PLANT, RK4(PLANT, 51), law, 0.01, D_hat=1.6, actuator="measured")
    for k in range(300):
        np.testing.assert_allclose(controller.D_hat, loop.D_hat[k], rtol=1e-12)
        U = controller.step(loop.samples.X[k], loop.samples.u[k], at_nodes(loop.U, k, 51, 100))
        np.testing.assert_allclose(U, loop.U[k], rtol=1e-9, atol=1e-12)


def test_what_it_sees_is_the_loops_own_and_may_not_be_written_to():
    class Vandal(npred.DelayLaw):
        def rate(self, plant, X, u, P, D_hat, t):
            X[:] = 0.0

    with pytest.raises(
        ConfigError, match=r"Vandal: rate \(test_delay_law.py:\d+\) failed at .*read-only; let it return"
    ):
        loops(Vandal())


def test_shapes_are_batch_first():
    seen = {}

    class Look(npred.DelayLaw):
        def rate(self, plant, X, u, P, D_hat, t):
            seen.update(X=X.shape, u=u.shape, P=P.shape, D_hat=D_hat.shape, f=plant.f(P, u).shape, t=t)
            return 0.0

    loops(Look())
    expected = {"X": (2, 1), "u": (2, 51, 1), "P": (2, 51, 1), "D_hat": (2,), "f": (2, 51, 1), "t": 3.0}
    assert seen == expected


@pytest.mark.parametrize(
    ("law", "message"),
    [
        (lambda self, plant, X, u, P, D_hat, t: X, r"expected to return \(2,\), one per loop, got \(2, 1\)"),
        (lambda self, plant, X, u, P, D_hat, t: None, r"rate \(test_delay_law.py:\d+\) expected .*, got None"),
        (lambda self, plant, X, u, P, D_hat, t: X.nothing, r"failed at test_delay_law.py:\d+: AttributeError"),
        (lambda self, plant, X: 0.0, r"failed: TypeError: .*takes 3 positional arguments"),
    ],
)
def test_a_law_that_fails_is_told_with_its_line(law, message):
    with pytest.raises(ConfigError, match=message) as caught:
        loops(type("Wrong", (npred.DelayLaw,), {"rate": law})())
    assert "\n" not in str(caught.value)


def test_a_law_may_refuse_a_plant():
    class Choosy(Towards):
        def check(self, plant):
            raise ConfigError(f"Choosy: not for plant {plant.name}")

    with pytest.raises(ConfigError, match="Choosy: not for plant scalar"):
        loops(Choosy())


@pytest.mark.parametrize("wrong", [{"gamma": 0.0}, {"b": -1.0}, {"bounds": (2.0, 1.0)}, {"bounds": (0.1, np.inf)}])
def test_settings_that_make_no_sense_are_told(wrong):
    with pytest.raises(ConfigError, match="adaptation: expected"):
        Towards(**wrong)


LAW = """
import npred

class Towards(npred.DelayLaw):
    def rate(self, plant, X, u, P, D_hat, t):
        return self.gamma * (1.0 - D_hat)
"""


@pytest.fixture
def law(tmp_path: Path) -> str:
    """A law's file; its name for a pipeline."""
    (tmp_path / "my_law.py").write_text(LAW)
    return f"{tmp_path / 'my_law.py'}:Towards"


def loop(**changes) -> config.LoopTable:
    return config.LoopTable(**{"gamma": 2.0, "b": 0.5, "bounds": (0.2, 3.0)} | changes)


def question(stage: str, adaptation: str | None) -> dict:
    changed = {} if adaptation is None else {stage: {"adaptation": adaptation}}
    return settings_of(Node(stage, None, ()), config.parse(tables(**changed), "tests"))


def test_laws_by_name_and_from_a_file(law):
    assert conditions.adaptation(loop(), PLANT) == DelayAdaptation(2.0, 0.5, (0.2, 3.0))
    assert conditions.adaptation(config.LoopTable(adaptation="frozen"), PLANT) is None
    with pytest.raises(ValueError, match='gamma: expected a law that adapts D_hat, got adaptation = "frozen"'):
        loop(adaptation="frozen")
    own = conditions.adaptation(loop(adaptation=law), PLANT)
    assert own is not None
    assert (type(own).__name__, own.gamma, own.b, own.bounds) == ("Towards", 2.0, 0.5, (0.2, 3.0))


@pytest.mark.parametrize("stage", ["generate", "evaluate"])
def test_a_law_enters_the_key_and_that_of_a_file_by_its_code(stage, law):
    plain, frozen, own = (question(stage, name) for name in (None, "frozen", law))
    assert question(stage, "bresch-pietri-krstic") == plain
    assert frozen[stage] == plain[stage] | {"adaptation": "frozen", "bounds": frozen[stage]["bounds"]}
    path = Path(law.partition(":")[0])
    moved = path.rename(path.parent / "moved.py")
    assert question(stage, f"{moved}:Towards") == own
    moved.write_text(LAW + "# a comment\n")
    assert question(stage, f"{moved}:Towards") == own
    moved.write_text(LAW + "another = 1\n")
    assert question(stage, f"{moved}:Towards") != own


def test_data_are_made_with_the_law(tmp_path, law):
    """D_hat' = gamma (1 - D_hat) from 2 s: after t seconds D_hat = 1 + exp(-gamma t), but for Euler's steps."""
    changes = {"D_hat": [[2.0, 2.0]], "samples": 60, "rollouts": 3}
    for name in ("frozen", law):
        run = job(
            tmp_path,
            name[-7:],
            plant="scalar",
            generate=changes | ({} if name == "frozen" else {"gamma": 0.5}) | {"adaptation": name},
        )
        generate.run(run)
        data = Dataset.read(run.folder / "data.h5")
        expected = 2.0 if name == "frozen" else 1.0 + np.exp(-0.5 * data.t)
        np.testing.assert_allclose(data.D_hat, expected, atol=3e-3)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (LAW.replace("(npred.DelayLaw)", ""), "expected a subclass of npred.DelayLaw"),
        (LAW.replace("def rate", "def phi"), "expected a class with rate, got none; define it"),
        (LAW.replace("class Towards", "class Away"), "expected a class Towards, found Away"),
        (LAW.replace("return", "retrun x"), "my_law.py:6: expected Python, got a syntax error"),
        (LAW + "1 / 0\n", "my_law.py:7: failed on import: ZeroDivisionError"),
        (LAW + "    def check(self, plant):\n        raise npred.errors.ConfigError('not this one')\n", "not this one"),
    ],
)
def test_a_file_that_is_no_law_is_told(law, text, message):
    Path(law.partition(":")[0]).write_text(text)
    with pytest.raises(ConfigError, match=message) as caught:
        conditions.adaptation(loop(adaptation=law), plants.resolve("scalar"))
    assert "\n" not in str(caught.value)


COMPILED = (
    LAW
    + """
    def kernel(self, plant):
        return problem.build("towards", problem.UPDATE, BODY)
"""
)
COMPILED = COMPILED.replace(
    "import npred",
    "import npred\nfrom npred.prediction.delays import problem\n\nBODY = "
    + repr("    for (int l = 0; l < d.lanes; l++) {\n        phi[l] = 1.0 - D_hat[l];\n    }\n"),
)


def test_a_law_with_a_kernel_is_compiled_and_is_one_file(law):
    path = Path(law.partition(":")[0])
    settings = loop(adaptation=law, gamma=2.0)
    interpreted = conditions.adaptation(settings, PLANT)
    path.write_text(COMPILED)
    compiled = conditions.adaptation(settings, PLANT)
    assert [delay_law.part(PLANT, each, 0.01).compiled for each in (interpreted, compiled)] == [False, True]
    np.testing.assert_allclose(loops(compiled).D_hat, loops(interpreted).D_hat, rtol=1e-13)


def test_a_subclass_that_changes_a_compiled_law_runs_in_python():
    class Choosy(DelayAdaptation):
        def check(self, plant):
            pass

    flags = {
        law: delay_law.part(PLANT, law(1.0, 1.0, (0.1, 4.0)), 0.01).compiled
        for law in (DelayAdaptation, Choosy, Leaky, Same)
    }
    assert flags == {DelayAdaptation: True, Choosy: True, Leaky: False, Same: False}


def test_a_law_of_a_package_has_a_name(package, tmp_path):
    package("towards = shed_of_tanks:Towards", LAW, "npred.delay_laws")
    assert type(conditions.adaptation(loop(adaptation="towards"), PLANT)).__name__ == "Towards"
    asked = question("generate", "towards")["generate"]["adaptation"]
    assert asked == {"name": "towards", "target": "shed_of_tanks:Towards", "package": "shed-of-tanks", "version": "1.0"}
    run = job(tmp_path, "data", plant="scalar", generate={"adaptation": "towards", "samples": 20, "rollouts": 2})
    generate.run(run)
    assert np.isfinite(Dataset.read(run.folder / "data.h5").D_hat).all()


def test_an_unknown_law_is_refused_where_the_pipeline_is_read():
    words = "evaluate.adaptation: expected bresch-pietri-krstic, .*, frozen, or a class of a file .*did you mean frozen"
    with pytest.raises(ConfigError, match=words):
        question("evaluate", "frozn")


def test_a_missing_file_is_told():
    with pytest.raises(ConfigError, match=r"adaptation none.py:Law: expected a Python file, found none at none.py"):
        conditions.adaptation(loop(adaptation="none.py:Law"), PLANT)
