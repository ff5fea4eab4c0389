"""What is exported, under each C compiler of this machine: none warns, and all compute the same numbers."""

import subprocess
import zipfile

import numpy as np
import pytest
from c_controllers import COMPILERS, find_nothing
from operator_samples import PLANT, SMALL, operator, samples
from self_tested import TWELVE

import npred
from npred import exports
from npred.exports import WholeController, c_controller, c_files, c_network
from npred.networks.fused import Fused

STRICT = ["-std=c99", "-O1", "-Wall", "-Wextra", "-Wpedantic", "-Wshadow", "-Wconversion"]
EACH = pytest.mark.parametrize("compiler", COMPILERS)


class Pendulum:
    """It is set to an angle."""

    states, inputs, parameters = ("angle", "speed"), ("torque",), {"aim": 0.2}
    box = {"angle": (-1.2, 1.2), "speed": (-2.0, 2.0)}
    input_bounds = ((-9.0, 9.0),)

    def f(x, u, t, p, M):
        return [x.speed, M.sin(x.angle) - x.speed + u.torque]

    def setpoint(x, t, p, M):
        return [x.angle - p.aim]


def settable():
    plant = npred.plant(Pendulum, kappa="lqr")
    return npred.controller(plant, npred.predictor(plant, "rk4", 21), None, 0.01, D_hat=0.2, actuator="history")


def learned():
    network = npred.guarded(Fused(PLANT, operator(SMALL[0]).double(), 21), 0.01)
    law = npred.DelayAdaptation(1000.0, bounds=(0.05, 0.2))
    return npred.controller(PLANT, network, law, 0.01, D_hat=0.2, actuator="measured")


# Each with the arguments of the export: between them, all variants of the skeleton.
CASES = {
    "network and guard, tunable": (learned, {"precision": "float", "tunable": True}),
    "set-point, under another name": (settable, {"name": "tank"}),
    "two inputs, watchdog, float": (TWELVE["two inputs, watchdog"][0], {"precision": "float"}),
    "observer of the delay": (TWELVE["observer of the delay"][0], {}),
    "filter": (TWELVE["filter"][0], {}),
    "filter, float": (TWELVE["filter"][0], {"precision": "float"}),
    "EKF with an offset, float": (TWELVE["EKF"][0], {"precision": "float"}),
    "declared delay": (TWELVE["declared"][0], {}),
}


@pytest.fixture(scope="module")
def written(tmp_path_factory, quickly_compiled):
    """A folder for each case with its two files, named npred, and the variants of each."""
    variants, fill = [], c_files.filled

    def filled(file, name, real, chosen, included):
        variants.append(chosen)
        return fill(file, name, real, chosen, included)

    folders = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(c_files, "filled", filled)
        for case, (make, options) in CASES.items():
            folders[case] = tmp_path_factory.mktemp("case")
            name = options.get("name", "npred")
            for suffix, text in zip("hc", c_controller.sources(make(), **options), strict=True):
                (folders[case] / f"{name}.{suffix}").write_text(text)
    return folders, variants


def source(case):
    return f"{CASES[case][1].get('name', 'npred')}.c"


def test_the_cases_have_all_variants_of_a_controller(written):
    """Each is there, and is left out: a warning may be in either."""
    for variant in written[1][0]:
        assert {bool(chosen[variant]) for chosen in written[1]} == {False, True}, variant


@pytest.mark.parametrize("compiler", [name for name in COMPILERS if name != "zig"])  # which has no -fsyntax-only
@pytest.mark.parametrize("case", CASES)
def test_no_compiler_warns_of_a_controller_as_it_stands(written, compiler, case):
    more = ["-Wdouble-promotion"] if CASES[case][1].get("precision") == "float" else []
    find_nothing(written[0][case], source(case), *STRICT, *more, names=[compiler])


@EACH
def test_nor_of_a_network_alone_or_of_an_fmu(tmp_path, monkeypatch, compiler):
    data = samples(2, 11, 0)
    text = c_network.source(operator(SMALL[1]), PLANT, 11, (data.X, data.u, data.D_hat, np.ones(2)))
    (tmp_path / "network.c").write_text(text)
    find_nothing(tmp_path, "network.c", *STRICT, names=[compiler])
    monkeypatch.setattr(c_files, "compiler", lambda: None)  # the sources alone
    for version in (2, 3):
        file = tmp_path / f"fmi{version}.fmu"
        exports.writer("fmu", {"fmi": version})(WholeController(TWELVE["EKF"][0](), ""), file)
        with zipfile.ZipFile(file) as archive:
            archive.extractall(tmp_path / file.stem)
        find_nothing(tmp_path / file.stem / "sources", f"{file.stem}.c", *STRICT, names=[compiler])


@pytest.mark.slow
@EACH
@pytest.mark.parametrize("case", CASES)
def test_under_each_its_own_test_passes_to_the_bit_in_double(written, compiler, case):
    """No operation is contracted; libm is that of this machine. Here zig too has no warning."""
    target, prefix = written[0][case] / compiler, source(case)[:-2].upper()
    strict = [*STRICT, "-Werror"] if compiler == "zig" else []
    words = [*COMPILERS[compiler], *strict, "-std=c99", "-O2", "-ffp-contract=off", f"-D{prefix}_TEST", source(case)]
    subprocess.run([*words, "-o", str(target), "-lm"], cwd=written[0][case], check=True, timeout=300)
    done = subprocess.run([target], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stdout
    assert "precision" in CASES[case][1] or "difference: 0.00e+00" in done.stdout
