"""What a plant's author may declare, and one clear line for what not."""

import json
import math
import re
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from npred.base.errors import ConfigError
from npred.formulas import array_math
from npred.lab import config
from npred.lab.scheduler.configuration import Slices, identity
from npred.plants.base import Plant
from npred.plants.declaration import Declaration


class Tank:
    states, inputs, parameters = ("h",), ("q",), {"c": 0.5}
    box, guess = {"h": (0.5, 2.0)}, (1.0,)

    @staticmethod
    def f(x, u, t, p, M):
        return [u.q - p.c * x.h]

    @staticmethod
    def kappa(x, t, p, M):
        return [p.c - x.h]

    @staticmethod
    def V(x, t, p, M):
        return x.h**2


def plant(**parts):
    return Plant("Tank", type("Changed", (Tank,), parts))


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        ({"states": "h"}, r"states: expected different names, as \(\"h\",\), got 'h'; write"),
        ({"states": None}, "states: expected different names"),
        ({"states": ()}, "states: expected different names"),
        ({"states": {"h"}}, "states: expected different names"),
        ({"states": ("h", "h")}, "states: expected different names"),
        ({"states": ("class",)}, r"states\[0\]: expected a name that Python accepts, got 'class'"),
        ({"states": ("_h",)}, "expected a name that Python accepts"),
        ({"inputs": (1,)}, r"inputs\[0\]: expected a name that Python accepts, got 1"),
        ({"inputs": ()}, "inputs: expected different names"),
        ({"parameters": ["c"]}, "parameters: expected a table"),
        (
            {"parameters": {"A": np.eye(2)}},
            r"parameters\['A'\]: expected a finite .*; give each number of an array a name, or",
        ),
        ({"parameters": {"in": 1.0}}, r"parameters\['in'\]: expected a name that Python accepts, got 'in'"),
        ({"parameters": {"c": "half"}}, r"parameters\['c'\]: expected a finite number, got 'half'"),
        ({"parameters": {"c": math.nan}}, r"parameters\['c'\]: expected a finite number, got nan"),
        ({"box": {"level": (0, 1)}}, "box: expected one of h, got 'level'"),
        ({"box": {"h": 3}}, r"box\['h'\]: expected a range \(low, high\)"),
        ({"box": {"h": (2.0, 1.0)}}, "with low <= high"),
        ({"box": {"h": (0.0, math.inf)}}, r"box\['h'\]\[1\]: expected a finite number, got inf"),
        ({"box": [(0, 1)]}, "box: expected ranges as"),
        (
            {"delay": staticmethod(lambda x, u, t, p, M: 1.0)},
            r"delay: a delay that depends on the input is not supported, got delay\(x, u, t, p, M\); write delay",
        ),
        ({"guess": (1.0, 2.0)}, r"guess: expected one for each of h, got \(1.0, 2.0\)"),
        ({"guess": 1.0}, "guess: expected one number per state, got 1.0"),
        ({"guess": ("a",)}, r"guess\[0\]: expected a finite number, got 'a'"),
        ({"input_bounds": [(0, 1), (0, 1)]}, "input_bounds: expected one for each of q"),
        (
            {"input_bounds": (0, 1)},
            r"input_bounds: expected a pair \(low, high\) per input, got \(0, 1\); write \(\(0.0",
        ),
        ({"input_bounds": {"q": (0, 1)}}, r"input_bounds: expected a pair .*, got {'q'"),
        ({"label": {"h": "level"}}, r"label: unknown part; did you mean labels\?; rename it"),
        ({"input_bound": [(0, 1)]}, r"input_bound: unknown part; did you mean input_bounds"),
        (
            {"bounds": [(0, 1)]},
            r"bounds: unknown part; did you mean input_bounds or box\?; rename it, or begin it with an",
        ),
        ({"u_max": 1.0}, r"u_max: unknown part; did you mean input_bounds\?; rename it"),
        ({"rate_limit": 1.0}, "rate_limit: unknown part; declare the actuator as a state"),
        ({"events": ()}, "events: unknown part; states do not jump: did you mean state_bounds, or M.where in f"),
        ({"reset": Tank.f}, "reset: unknown part; states do not jump"),
        ({"tau": 0.5}, r"tau: unknown part; did you mean delays, or D of the loop\?"),
        ({"D": 0.5}, r"D: unknown part; did you mean delays, or D of the loop\?"),
        ({"disturbance": Tank.f}, "disturbance: unknown part; it is the loop's: pass it to npred.simulate"),
        ({"flow": Tank.f}, "flow: unknown part; rename it, or begin it with an underscore"),
        ({"parameter": {}}, r"parameter: unknown part; did you mean parameters"),
        ({"df": Tank.f}, "df: unknown part"),
        ({"input_bounds": [(1, 0)]}, r"input_bounds\[0\]: expected a range"),
        ({"state_bounds": {"q": (0, 1)}}, "state_bounds: expected one of h, got 'q'"),
        ({"input_bounds": np.array([[0, math.nan]])}, r"input_bounds\[0\]: expected a range"),
        ({"input_bounds": "none"}, r"input_bounds: expected a pair \(low, high\) per input, got 'none'"),
        ({"units": "m"}, "units: expected texts as"),
        ({"units": {"level": "m"}}, "units: expected one of h, q, got 'level'"),
        ({"labels": {"h": 3}}, r"labels\['h'\]: expected up to 40 letters on one line, .* got 3; shorten it"),
        ({"labels": {"h": "h\nq"}}, "on one line"),
        ({"labels": {"h": "$h"}}, r"without \$ and backslash"),
        ({"time_unit": "a" * 41}, "time_unit: expected up to 40 letters"),
        ({"delays": 0.5}, "delays: expected the time of each input, got 0.5"),
        ({"delays": (0.5, 0.6)}, "delays: expected one for each of q"),
        ({"delays": (0.0,)}, r"delays: expected a delay above 0, got none; drop delays, and give the loop D = 0"),
        ({"delays": (-0.1,)}, r"delays\[0\]: expected a time, 0 or more, got -0.1"),
        ({"delays": ("late",)}, r"delays\[0\]: expected a time, 0 or more, got 'late'"),
        ({"f": 3}, "f: expected a function, got 3"),
        ({"inputs": ("q")}, r"inputs: expected different names, .* got 'q'; write \(\"q\",\), with the comma"),
        ({"states": "h, v"}, r"states: expected different names, .* got 'h, v'; write \(\"h\", \"v\"\), with"),
        ({"inputs": 3}, r"inputs: expected different names, .* got 3; write each once, in quotes"),
        ({"inputs": "q q"}, r"inputs: expected different names, .* got 'q q'; write each once, in quotes"),
        ({"guess": 1}, r"guess: expected one number per state, got 1; write \(1,\), with the comma"),
        ({"guess": "a"}, r"guess: expected one number per state, got 'a'; write numbers"),
        ({"guess": True}, r"guess: expected one number per state, got True; write numbers"),
        ({"delays": 0.1}, r"delays: expected the time of each input, got 0.1; write \(0.1,\), with the comma"),
    ],
)
def test_a_wrong_part_is_told_in_one_line(parts, message):
    with pytest.raises(ConfigError, match=message) as caught:
        plant(**parts)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "value", ["1.0", b"1", True, np.True_, np.array("1.0"), np.array(True), np.array([1.0]), [1.0]]
)
@pytest.mark.parametrize("part", ["parameters", "box", "guess", "input_bounds", "state_bounds", "delays", "period"])
def test_a_number_is_no_text_no_truth_value_and_no_array(part, value):
    """float() makes 1.0 of each of them."""
    shapes = {"parameters": {"c": value}, "period": value, "input_bounds": [(0.0, value)]}
    shapes |= dict.fromkeys(("guess", "delays"), (value,))
    shapes |= {part: {"h": (0.0, value)} for part in ("box", "state_bounds")}
    with pytest.raises(ConfigError, match=rf"plant Tank: {part}.*: expected a") as caught:
        plant(**{part: shapes[part]})
    assert repr(value) in str(caught.value)
    if part == "parameters":
        with pytest.raises(ConfigError, match=r"parameters\['c'\]: expected a finite number"):
            Plant("Tank", Tank, {"c": value})


@pytest.mark.parametrize("value", [1, np.float32(1), np.int64(1), np.array(1.0), Fraction(1)])
def test_a_number_may_be_of_any_kind(value):
    assert plant(parameters={"c": value}).parameters == {"c": 1.0}


def test_what_is_no_part_begins_with_an_underscore_in_bases_too():
    class Base:
        @staticmethod
        def outflow(h):
            return h

    assert plant(_outflow=Base.outflow).states == ("h",)
    with pytest.raises(ConfigError, match="outflow: unknown part"):
        Plant("Tank", type("Changed", (Tank, Base), {}))


@pytest.mark.parametrize("value", [None, "1", [1.0], {"h": 1.0}])
@pytest.mark.parametrize("name", ["f", "V"])
def test_what_a_function_returns_is_checked(name, value):
    values = value if name == "V" else [value]
    place = r"\(test_declaration.py:\d+\)"
    with pytest.raises(ConfigError, match=f"Tank: {name} {place} expected to return numbers and formulas, got"):
        _ = identity(plant(**{name: staticmethod(lambda *_: values)}))


def test_one_sided_input_bounds_are_part_of_a_json_identity():
    assert plant(input_bounds=np.array([[0.0, math.inf]])).input_bounds == [(0.0, math.inf)]
    assert json.loads(json.dumps(identity(plant(input_bounds=[(0, math.inf)])), allow_nan=False))["input_bounds"] == [
        [0.0, "inf"]
    ]


def test_a_bare_number_is_one_component_on_arrays_too():
    bare, X = plant(f=staticmethod(lambda x, u, t, p, M: u.q - p.c * x.h)), np.ones((4, 3, 1))
    np.testing.assert_array_equal(bare.f(X, X), plant().f(X, X))


def test_labels_and_units_are_no_part_of_what_a_result_depends_on():
    named = plant(labels={"h": "level"}, units={"h": "m", "q": "m^3/h"}, time_unit="h")
    written = Slices(config.Pipeline(plant=""), named, None, "cpu").notation["notation"]
    assert written == {"labels": {"h": "level"}, "units": {"h": "m", "q": "m^3/h"}, "time_unit": "h", "figure": ""}
    assert identity(named) == identity(plant())


class Everything(Tank):
    """All that the identity of a traced plant holds."""

    input_bounds, state_bounds, period = [(0.0, 2.0)], {"h": (0.0, 3.0)}, 4.0
    f = staticmethod(lambda x, u, t, p, M: [u[0] - p.c * x[0]])
    V = staticmethod(lambda x, t, p, M: x[0] ** 2)
    kappa = staticmethod(lambda x, t, p, M: [p.c - x[0] + M.sin(2 * M.pi * t / 4.0)])
    delay = staticmethod(lambda x, t, p, M: 0.1)
    reference = staticmethod(lambda t, p, M: [M.sin(2 * M.pi * t / 4.0)])


OTHERS = {
    "states": ("level",), "inputs": ("flow",), "parameters": {"c": 0.6}, "box": {"h": (0.5, 2.5)}, "guess": (1.5,),
    "input_bounds": [(0.0, 3.0)], "state_bounds": {"h": (0.0, 4.0)}, "period": 2.0,
    "f": staticmethod(lambda x, u, t, p, M: [u[0] - p.c * x[0] * x[0]]),
    "kappa": staticmethod(lambda x, t, p, M: [p.c - 2 * x[0] + M.sin(2 * M.pi * t / 4.0)]),
    "V": staticmethod(lambda x, t, p, M: x[0] ** 4),
    "delay": staticmethod(lambda x, t, p, M: 0.2),
    "reference": staticmethod(lambda t, p, M: [M.cos(2 * M.pi * t / 4.0)]),
}  # fmt: skip
SHOWN = {"labels", "units", "time_unit", "figure"}  # by figures only
SLICED = {"mechanics", "observation", "output", "outputs", "safe"}  # of results that read them, below
OF_KINDS = {"rollout", "delays", "setpoint"}  # of a black box, of several inputs, in place of the reference


def test_each_part_that_a_result_depends_on_tells_plants_apart():
    assert OTHERS.keys() | SHOWN | SLICED | OF_KINDS == Declaration.model_fields.keys()
    same, other = (Plant("Tank", type("Changed", (Everything,), {})) for _ in range(2))
    assert identity(same) == identity(other)
    for part, value in OTHERS.items():
        renamed = {"box": {}, "state_bounds": {}} if part == "states" else {}
        here = Plant("Tank", type("Changed", (Everything,), renamed))
        there = Plant("Tank", type("Changed", (Everything,), renamed | {part: value}))
        assert identity(here) != identity(there), part


def mover(**parts):
    """A plant with two inputs, and what only some results read."""
    return Plant("Mover", type("Mover", (Mover,), parts))


class Mover:
    states, inputs, delays = ("x", "v"), ("a", "b"), (0.1, 0.2)
    box = {"x": (0.0, 1.0), "v": (0.0, 1.0)}
    f = staticmethod(lambda x, u, t, p, M: [x.v, u.a + u.b - x.v])
    kappa = staticmethod(lambda x, t, p, M: [-x.x, -x.v])
    mechanics = staticmethod(lambda x, u, t, p, M: ([[1.0]], [u.a + u.b], [1.0]))
    output = staticmethod(lambda x, t, p, M: [x.x, x.v])
    safe = staticmethod(lambda x, t, p, M: [1.0 - x.x])


MECHANICS = {"mechanics": staticmethod(lambda x, u, t, p, M: ([[2.0]], [2 * u.a + 2 * u.b], [2.0]))}
OUTPUT = {"output": staticmethod(lambda x, t, p, M: [x.x + x.v, x.v])}
SAFE = {"safe": staticmethod(lambda x, t, p, M: [2.0 - x.x])}


def test_delays_of_the_inputs_tell_plants_apart():
    assert identity(mover()) != identity(mover(delays=(0.2, 0.1)))


@pytest.mark.parametrize(
    ("stage", "table", "part", "told"),
    [
        ("evaluate", {}, MECHANICS, True),  # a guard may choose the method that reads it
        ("evaluate", {"predictor": "semi_implicit"}, MECHANICS, True),
        ("generate", {"predictor": "semi_implicit"}, MECHANICS, True),
        ("generate", {}, MECHANICS, False),
        ("evaluate", {}, SAFE, True),  # it says how limits are kept
        ("generate", {"actuator": "history", "safety": {}}, SAFE, True),
        ("generate", {}, SAFE, False),
        ("generate", {"actuator": "history", "observer": {}}, OUTPUT, True),
        ("evaluate", {"actuator": "history", "scenarios": [{"name": "a", "observer": {}}]}, OUTPUT, True),
        ("evaluate", {}, OUTPUT, False),
    ],
)
def test_loops_depend_on_the_parts_that_they_read_and_on_no_others(stage, table, part, told):
    pipeline = config.parse({"plant": "", stage: {"gamma": 1.0} | table}, "p.toml")
    here, there = (Slices(pipeline, plant, None, "cpu").loop(stage) for plant in (mover(), mover(**part)))
    assert (here != there) is told


def test_every_part_that_is_read_stands_on_the_page_of_the_declaration():
    root = Path(__file__).parents[2]
    code = "".join(path.read_text() for path in (root / "npred" / "plants").glob("*.py"))
    parts = set(re.findall(r'(?:get|has)attr\((?:self\.)?declaration, "(\w+)"', code)) | {*Declaration.model_fields}
    page = (root / "docs" / "plant_declaration.md").read_text()
    assert {"f", "delays", "period", "df", "files", "traced"} <= parts
    assert [part for part in sorted(parts) if not re.search(rf"`{part}[`(]", page)] == []
    assert [name for name in vars(array_math.NUMPY) if not re.search(rf"\b{name}\b", page)] == []
