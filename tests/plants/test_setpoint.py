"""The rest of a set-point: the same in every unit, followed from the last one, within its bounds."""

import ctypes
import re
from typing import Any

import numpy as np
import pytest
from c_controllers import InC, library, needs_gcc
from fmus import InFmu, exported, needs_cc
from hypothesis import given, settings
from hypothesis import strategies as st

import npred
from npred import diagnosis
from npred.base.errors import ConfigError
from npred.plants import setpoint

POWERS = st.integers(-12, 12).map(lambda k: 10.0**k)


def declared(f, aims, box, inputs, **parts) -> Any:
    """A plant whose set-points are those of its states that `aims` names; f(x, u, M) gives the rates."""
    return type("Declared", (), {
        "states": tuple(box), "inputs": tuple(inputs), "box": box, "input_bounds": tuple(inputs.values()),
        "parameters": {f"aim_{name}": value for name, value in aims.items()},
        "f": lambda x, u, t, p, M: f(x, u, M),
        "setpoint": lambda x, t, p, M: [getattr(x, name) - getattr(p, f"aim_{name}") for name in aims],
    } | parts)  # fmt: skip


def pendulum(second=1.0, size=1.0, **parts):
    """9 sin(angle) is the torque that holds it; `second` and `size` are a second and a radian in its units."""

    def f(x, u, M):
        return [x.rate, (u.torque - 9.0 * M.sin(x.angle / size)) * size / second**2]

    box = {"angle": (-1.5 * size, 1.5 * size), "rate": (-3.0 * size / second, 3.0 * size / second)}
    return npred.plant(declared(f, {"angle": 0.3 * size}, box, {"torque": (-8.0, 8.0)}, **parts))


def quadruple():
    """Four tanks, their levels in cm, two pumps in V, by Johansson, 2000."""

    def f(x, u, M):
        holes, areas, levels = (0.071, 0.057, 0.071, 0.057), (28.0, 32.0, 28.0, 32.0), (x.h1, x.h2, x.h3, x.h4)
        out = [a * M.sqrt(2 * 981 * M.maximum(h, 1e-6)) for a, h in zip(holes, levels, strict=True)]
        q1, q2 = 3.33 * u.v1, 3.35 * u.v2
        flows = [out[2] - out[0] + 0.7 * q1, out[3] - out[1] + 0.6 * q2, 0.4 * q2 - out[2], 0.3 * q1 - out[3]]
        return [flow / area for flow, area in zip(flows, areas, strict=True)]

    box = {"h1": (5.0, 20.0), "h2": (5.0, 20.0), "h3": (0.5, 5.0), "h4": (0.5, 5.0)}
    bounds = {"v1": (0.0, 10.0), "v2": (0.0, 10.0)}
    return declared(f, {"h1": 12.4, "h2": 12.7}, box, bounds, guess=(12.4, 12.7, 1.8, 1.4))


def controller(plant, **parts):
    return npred.controller(plant, npred.predictor(plant, "rk4", 5), None, 0.01, D_hat=0.2, u0="equilibrium", **parts)


def asked(plant, p, **values):
    free = np.tile([-np.inf, np.inf], (plant.m, 1)) if plant.input_bounds is None else np.array(plant.input_bounds)
    return setpoint.changed(plant, p, values, {}, setpoint.bounds(plant, free))


@settings(max_examples=15, deadline=None)
@given(POWERS, POWERS, st.lists(st.floats(-1.5, 1.5), min_size=1, max_size=6))
def test_a_set_point_is_taken_or_refused_alike_in_every_unit(second, size, aims):
    """Taken if, and only if, the torque 9 sin(angle) is within its bounds."""
    plant = pendulum(second, size)
    p = plant.p
    for aim in aims:
        needed = 9.0 * np.sin(aim)
        if abs(abs(needed) - 8.0) < 1e-6:
            continue
        try:
            p = asked(plant, p, aim_angle=aim * size)
        except ConfigError as error:
            assert abs(needed) > 8.0 and "got torque = " in str(error)
            continue
        assert abs(needed) < 8.0
        np.testing.assert_allclose(p[1:] / [size, size / second, 1.0], [aim, 0.0, needed], rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("unit", ["ns", "day"])
def test_the_plant_itself_rests_in_every_unit(unit):
    second = {"ns": 1e9, "day": 1 / 86400}[unit]
    plant = pendulum(second, time_unit=unit)
    other = npred.plant(plant.declared, kappa="lqr", aim_angle=-0.8)
    np.testing.assert_allclose(other.equilibrium * [1, second], [-0.8, 0.0], atol=1e-9)
    usual = npred.plant(pendulum().declared, kappa="lqr", aim_angle=-0.8)
    gains = [each.kappa_jacobian(each.equilibrium)[0] for each in (other, usual)]
    np.testing.assert_allclose(gains[0] / [1, second], gains[1], rtol=1e-6)


@needs_gcc
def test_a_far_set_point_is_that_of_many_near_ones_in_c_too(tmp_path):
    plant = npred.plant(quadruple(), kappa="lqr")
    far, near = controller(plant), controller(plant)
    in_c = InC(library(far, tmp_path), plant)
    values = np.array([25.0, 25.3])
    assert in_c.library.npred_set_parameters(in_c.memory, values.ctypes.data_as(ctypes.c_void_p)) == 0
    far.set(aim_h1=25.0, aim_h2=25.3)
    for level in np.linspace(12.4, 25.0, 13)[1:]:
        near.set(aim_h1=level, aim_h2=level + 0.3)
    X = np.array([20.0, 20.0, 3.0, 3.0])
    np.testing.assert_allclose(far.settings.p, near.settings.p, rtol=1e-12)
    assert (far.step(X) == in_c.step(X)).all()


def test_a_steep_output_is_followed():
    """pH 7 to 3: of the ions that make this, one in 5000 is there at first."""

    class Neutraliser:
        states, inputs, parameters = ("a",), ("base",), {"pH": 7.0}
        box, input_bounds = {"a": (-1e-3, 1e-3)}, ((0.2, 2.0),)

        def f(x, u, t, p, M):
            return [3e-3 - x.a - u.base * (x.a + 3e-3)]

        def setpoint(x, t, p, M):
            y = x.a / 2e-7
            return [7.0 - M.sign(y) * M.log(M.abs(y) + M.sqrt(y * y + 1.0)) / M.log(10.0) - p.pH]

    plant = npred.plant(Neutraliser)
    for pH in (3.0, 10.9, 6.0, 2.8):
        a = 10.0**-pH - 10.0 ** (pH - 14)
        np.testing.assert_allclose(asked(plant, plant.p, pH=pH)[1:], [a, (3e-3 - a) / (a + 3e-3)], rtol=1e-9)


def test_a_table_with_kinks_is_passed():
    table = ([0.0, 0.2, 0.4, 0.7, 1.0], [0.0, 0.02, 0.15, 0.6, 1.0])

    def f(x, u, M):
        return [0.9 * M.interp(u.valve, *table) - 0.4 * M.sqrt(M.maximum(x.h, 1e-6))]

    plant = npred.plant(declared(f, {"h": 1.0}, {"h": (0.2, 3.0)}, {"valve": (0.0, 1.0)}))
    p = plant.p
    for level in (4.9, 0.004, 2.0, 0.1, 4.0):
        p = asked(plant, p, aim_h=level)
        np.testing.assert_allclose(0.9 * np.interp(p[2], *table), 0.4 * np.sqrt(level), rtol=1e-10)


def reactor(q, b=1.11, guess=(3.0, 1.11)):
    """Van de Vusse's: b has a largest value, 1.266, and two flows for each below it."""

    def f(x, u, M):
        return [-50 * x.a - 10 * x.a**2 + (10 - x.a) * u.q, 50 * x.a - 100 * x.b - x.b * u.q]

    box = {"a": (0.5, 5.0), "b": (0.5, 1.3)}
    return npred.plant(declared(f, {"b": b}, box, {"q": q}, guess=guess))


def test_a_rest_on_another_branch_is_named():
    plant = reactor((3.0, 77.0))
    assert asked(plant, plant.p, aim_b=1.26)[3] < 78
    with pytest.raises(ConfigError, match=r"aim_b = 1\.27, found none; the old set-point stays, choose another"):
        asked(plant, plant.p, aim_b=1.27)
    plant = reactor((30.0, 300.0))
    branch = r"another branch rests with .*q = 2.*; to use it, start there: guess = \[(.*), 0\.9\]"
    with pytest.raises(ConfigError, match=rf"got q = 19\.63; the old set-point stays, {branch}") as said:
        asked(plant, plant.p, aim_b=0.9)
    guess = float(re.search(branch, str(said.value))[1]), 0.9
    there = reactor((30.0, 300.0), b=0.9, guess=guess)
    assert 200 < there.p[3] < 300 and there.p[1] == pytest.approx(guess[0], rel=1e-3)


def test_what_no_equation_moves_stays():
    """A unicycle that stands somewhere has any heading."""

    def f(x, u, M):
        return [u.speed * M.cos(x.heading), u.speed * M.sin(x.heading), u.turn]

    box = {"x": (-2.0, 2.0), "y": (-2.0, 2.0), "heading": (-3.0, 3.0)}
    inputs = {"speed": (-1.0, 1.0), "turn": (-1.0, 1.0)}
    plant = npred.plant(declared(f, {"x": 0.5, "y": -0.5}, box, inputs, guess=(0.5, -0.5, 0.7)))
    np.testing.assert_allclose(asked(plant, plant.p, aim_x=-1.5, aim_y=1.0)[2:], [-1.5, 1.0, 0.7, 0, 0], atol=1e-12)


class Walled:
    """A tank with a rim at 2 m that is safe up to 1.5 m."""

    states, inputs, parameters = ("h",), ("q",), {"aim": 1.0}
    box, input_bounds, state_bounds, guess = {"h": (0.5, 2.0)}, ((0.0, 5.0),), {"h": (0.0, 2.0)}, (1.0,)

    def f(x, u, t, p, M):
        return [u.q - M.sqrt(M.maximum(x.h, 1e-6))]

    def setpoint(x, t, p, M):
        return [x.h - p.aim]

    def safe(x, t, p, M):
        return [1.5 - x.h, x.h]


@needs_gcc
@needs_cc
def test_beyond_state_bounds_it_is_refused_and_beyond_safe_it_is_said(tmp_path, capsys, monkeypatch):
    monkeypatch.delenv("NPRED_QUIET", raising=False)
    plant = npred.plant(Walled, kappa="lqr")
    one = controller(plant)
    in_c = InC(library(one, tmp_path), plant)
    in_c.library.npred_set_aim.argtypes = [ctypes.c_void_p, ctypes.c_double]
    path, written = exported(one, tmp_path)
    in_fmu = InFmu(path, tmp_path / "fmu", written, one.dt)
    capsys.readouterr()
    for aim, code, said in ((1.8, 7, "aim = 1.8: expected a rest where safe is at least 0, got -0.3"), (1.2, 0, "")):
        one.set(aim=aim)
        assert said in (line := capsys.readouterr().err) and bool(line) == bool(said)
        assert in_c.library.npred_set_aim(in_c.memory, aim) == code
        in_fmu.set("parameter.aim", aim)
        assert in_fmu.get("parameter.aim") == aim and len(in_fmu.messages) == 1
        assert one.step([1.0]) == in_c.step([1.0]) == in_fmu.step([1.0])
    with pytest.raises(ConfigError, match=r"for aim = 2\.1, got h = 2\.1; the old set-point stays"):
        one.set(aim=2.1)
    assert in_c.library.npred_set_aim(in_c.memory, 2.1) == 5
    with pytest.raises(Exception, match="status 2"):
        in_fmu.set("parameter.aim", 2.1)
    one.set(aim=2.0)  # on the rim
    assert one.step([1.0]) != in_c.step([1.0]) == in_fmu.step([1.0])
    in_fmu.close()


class Divided(Walled):
    """One limit is about the rest, one about the time; two are of the state, of which one is NaN above 1.6 m."""

    def safe(x, t, p, M):
        return [p.aim / p.rest_h - 0.5 * x.h / p.rest_h, 2.0 + t, 1.5 - x.h, M.sqrt(1.6 - x.h)]


@needs_gcc
@pytest.mark.parametrize(("aim", "got"), [(1.55, "-0.05"), (1.8, "nan")])
def test_limits_that_depend_on_the_rest_or_the_time_leave_the_others(tmp_path, capsys, monkeypatch, aim, got):
    monkeypatch.delenv("NPRED_QUIET", raising=False)
    plant = npred.plant(Divided, kappa="lqr")
    one = controller(plant)
    in_c = InC(library(one, tmp_path), plant)
    in_c.library.npred_set_aim.argtypes = [ctypes.c_void_p, ctypes.c_double]
    capsys.readouterr()
    one.set(aim=aim)
    assert f"expected a rest where safe is at least 0, got {got}; choose another" in capsys.readouterr().err
    assert in_c.library.npred_set_aim(in_c.memory, aim) == 7
    answers = {a.check: a for a in diagnosis.check(npred.plant(Divided, kappa="lqr", aim=aim), 0.2, samples=16)}
    assert answers["equilibrium"].verdict == "warn" and "limit " in answers["equilibrium"].text


@pytest.mark.parametrize(("aim", "verdict", "said"), [(1.2, "yes", "q = "), (1.8, "warn", "limit 1 of 2 = -0.3")])
def test_the_check_of_a_plant_says_where_its_rest_is_not_safe(aim, verdict, said):
    answers = {a.check: a for a in diagnosis.check(npred.plant(Walled, kappa="lqr", aim=aim), 0.2, samples=16)}
    assert answers["equilibrium"].verdict == verdict and said in answers["equilibrium"].text


def test_a_declared_set_point_beyond_state_bounds_is_refused():
    with pytest.raises(ConfigError, match=r"setpoint \(.*\) expected a rest within state_bounds for aim = 2\.1, got h"):
        npred.plant(Walled, kappa="lqr", aim=2.1)
