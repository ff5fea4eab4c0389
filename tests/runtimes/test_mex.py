"""The controller as a function of GNU Octave: its steps are npred.controller's, its handles, its refusals."""

import shutil
import subprocess

import numpy as np
import pytest
from conftest import HERE
from typer.testing import CliRunner

import npred
from npred.cli import app
from npred.runtimes import c_controller

missing = [tool for tool in ("octave-cli", "mkoctfile") if shutil.which(tool) is None]
needs_octave = pytest.mark.skipif(bool(missing), reason=f"no {' and '.join(missing)} on this machine")
PLANT = npred.plant("activator_repressor")
X0, DT = [0.03, 30.0], 0.01
PAGE = (HERE.parent / "docs" / "deployment.md").read_text()


def guarded():
    predictor = npred.guarded(npred.predictor("euler", PLANT, 21), 2.5e-5)
    return npred.controller(PLANT, predictor, npred.DelayAdaptation(1000.0, bounds=(0.1, 4.0)), DT, D_hat=2.0)


def turning():
    plant = npred.plant("unicycle")
    return npred.controller(plant, npred.predictor("heun", plant, 21), None, DT, D_hat=0.6, actuator="history")


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """A folder for each controller, with its MEX file."""
    places = {}
    for make in (guarded, turning):
        folder = places[make.__name__] = tmp_path_factory.mktemp(make.__name__)
        controller = make()
        header, source = c_controller.sources(controller)
        for name, text in (("npred.h", header), ("npred.c", source), ("npred_mex.c", c_controller.gateway(controller))):
            (folder / name).write_text(text)
        octave(folder, "mex -Wall -Wextra -Werror npred_mex.c npred.c")
    return places


def octave(folder, script):
    """What a script prints. Its failure fails the test."""
    (folder / "script.m").write_text(f"{script}\n")
    command = ["octave-cli", "--no-init-file", "--quiet", "script.m"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    return done.stdout


def written(folder, name, array):
    np.savetxt(folder / name, array, fmt="%.17g")


@needs_octave
def test_steps_are_those_of_the_controller_where_u_is_measured(folders):
    folder, controller, random = folders["guarded"], guarded(), np.random.default_rng(0)
    X, u = np.array(X0) * (1 + 0.1 * random.standard_normal((200, 2))), 1e-3 * random.standard_normal((200, 21))
    written(folder, "X.txt", X)
    written(folder, "u.txt", u)
    printed = octave(
        folder,
        """
        X = load('X.txt'); u = load('u.txt'); c = npred_mex('new');
        for k = 1:rows(X)
            [U, D_hat, P, fallback, error] = npred_mex('step', c, X(k, :), u(k, :)');
            printf('%.17g ', U, D_hat, P(end, :), fallback, error); printf('\\n');
        end""",
    )
    rows = np.array([line.split() for line in printed.splitlines()], dtype=float)
    expected = []
    for x, row in zip(X, u, strict=True):
        U = controller.step(x, row[:, None])
        expected.append([*U, controller.D_hat, *controller.P[-1], controller.fallback, controller.error])
    np.testing.assert_allclose(rows[:, :5], np.array(expected)[:, :5], rtol=1e-12)
    np.testing.assert_allclose(rows[:, 5], np.array(expected)[:, 5], rtol=1e-6)
    assert {0, 1} == set(rows[:, 4])


@needs_octave
def test_several_inputs_and_a_state_that_goes_on(folders):
    folder, controller = folders["turning"], turning()
    X = 0.3 * np.random.default_rng(1).standard_normal((300, 3))
    written(folder, "X.txt", X)
    printed = octave(
        folder,
        """
        X = load('X.txt'); one = npred_mex('new'); other = npred_mex('new');
        for k = 1:rows(X)
            U = npred_mex('step', one, X(k, :)); printf('%.17g ', U); printf('\\n');
            if k == 150, npred_mex('restore', other, npred_mex('state', one)); end
            if k > 150, assert(npred_mex('step', other, X(k, :)), U); end
        end""",
    )
    rows = np.array([line.split() for line in printed.splitlines()], dtype=float)
    np.testing.assert_allclose(rows, [controller.step(x).copy() for x in X], rtol=1e-12, atol=1e-14)


@needs_octave
def test_calls_on_a_clock_and_the_status(folders):
    folder, controller, random = folders["turning"], turning(), np.random.default_rng(2)
    t = np.cumsum(DT * random.uniform(0.6, 1.4, 200))
    X, came = 0.3 * random.standard_normal((200, 3)), np.arange(200) % 3 != 1
    at = t - 0.02 * random.random(200)
    written(folder, "X.txt", np.column_stack([t, at, came, X]))
    printed = octave(
        folder,
        """
        X = load('X.txt'); c = npred_mex('new');
        for k = 1:rows(X)
            sample = X(k, 4:6); if X(k, 3) == 0, sample = []; end
            U = npred_mex('step_at', c, X(k, 1), sample, X(k, 2)); s = npred_mex('status', c);
            printf('%.17g ', U, s.age, s.late, s.refused, s.missed, s.handed_over, s.innovation); printf('\\n');
        end""",
    )
    rows = np.array([line.split() for line in printed.splitlines()], dtype=float)
    expected = []
    for k in range(200):
        U = controller.step(X[k] if came[k] else None, t=t[k], sampled_at=at[k]).copy()
        s = controller.status
        expected.append([*U, s.age, s.late, s.refused, s.missed, s.handed_over, *s.innovation])
    np.testing.assert_allclose(rows, expected, rtol=1e-11, atol=1e-12)


REFUSED = [
    ("npred_mex('step', c, [NaN; 0; 0])", "expected finite X and u"),
    ("npred_mex('step', c, [0; 0])", "expected X with one number per state"),
    ("npred_mex('step', c, single([0; 0; 0]))", "expected X with one number per state"),
    ("npred_mex('step', c, [1i; 0; 0])", "expected X with one number per state"),
    ("npred_mex('step', 7, [0; 0; 0])", "expected a controller of 'new' that is not deleted"),
    ("npred_mex('step', NaN, [0; 0; 0])", "expected a controller of 'new' that is not deleted"),
    ("npred_mex('step', gone, [0; 0; 0])", "expected a controller of 'new' that is not deleted"),
    ("npred_mex('restore', c, zeros(4, 1, 'uint8'))", "expected the bytes of 'state'"),
    ("s(1) += 1; npred_mex('restore', c, s)", "expected a state of this controller"),
    ("npred_mex('set_time', c, Inf)", "expected a state of this controller, a number within its bounds or a time"),
    ("npred_mex('step_at', c, -9, [], 0)", "expected a state of this controller, a number within its bounds or a time"),
    ("npred_mex('step_at', c, 9, [0; 0], 9)", "expected X with one number per state"),
    ("npred_mex('leap', c)", "expected new, step, state"),
    ("npred_mex()", "expected new, step, state"),
    ("npred_mex('step', c)", "expected new, step, state"),
]


@needs_octave
def test_what_is_wrong_is_an_error_and_changes_nothing_but_a_sample_that_is_refused(folders):
    lines = ["c = npred_mex('new'); gone = npred_mex('new'); npred_mex('delete', gone);"]
    lines += ["npred_mex('step', c, [0.3; -0.2; 0.2]);"]
    for call, _ in REFUSED:
        lines += ["s = npred_mex('state', c); before = s;", f"try, {call}; disp('done');"]
        booked = "!" if "step', c, [NaN" in call else ""  # the command that is held, and the time
        lines += [f"catch e, disp(e.message); end; assert({booked}isequal(npred_mex('state', c), before));"]
    printed = octave(folders["turning"], "\n".join(lines)).splitlines()
    assert len(printed) == len(REFUSED)
    assert [line for line, (_, message) in zip(printed, REFUSED, strict=True) if message not in line] == []


def blocks(language, word):
    """The block of the page on deployment that has a word."""
    texts = [part.split("```")[0] for part in PAGE.split(f"```{language}\n")[1:]]
    (block,) = [text for text in texts if word in text]
    return block


@needs_octave
def test_the_page_s_example_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    flags = ["--predictor", "rk4", "--actuator", "history", "--mex", "-o", "octave", "--nx", "21"]
    done = CliRunner().invoke(app, ["export", "controller", "paper", *flags])
    assert done.exit_code == 0 and "octave/npred_mex.c" in done.stdout
    octave(tmp_path / "octave", f"{blocks('matlab', 'npred_mex')}\nassert(isfinite(U) && rows(P) == 21)")


def test_the_page_s_file_for_simulink_compiles(tmp_path):
    if shutil.which("cc") is None:
        pytest.skip("no C compiler on this machine")
    header, source = c_controller.sources(turning())
    text = blocks("C", "loop_step")
    prototypes = text.split("/* ")[1].split(" */")[0]
    for name, content in {"npred.h": header, "npred.c": source, "loop.h": prototypes, "loop.c": text}.items():
        (tmp_path / name).write_text(f"{content}\n")
    command = ["cc", "-std=c99", "-O1", "-Wall", "-Werror", "-c", "loop.c", "npred.c"]
    subprocess.run(command, cwd=tmp_path, check=True, timeout=120)
