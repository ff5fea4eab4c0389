"""The time of a whole control step of an exported controller in C on this machine: each step timed, in a program.

    python benchmarks/c_controller.py pipeline/paper.toml:deeponet --store artifacts

It exports the controller of the pipeline's evaluated loop with both predictors and precisions, with and without a
guard, compiles each, and runs it on the steps of its own test, over and over. Then controllers of the plant with an
extended Kalman filter of one output, called at jittering times with samples that are four control steps old, each
tenth call without one. The compiler's flags allow what they allow the kernels that run here
(npred.kernels.compiler.FLAGS), and NaN stays NaN.
"""

import json
import subprocess
import tempfile
from collections.abc import Iterator
from itertools import product
from pathlib import Path

import harness

import npred
from npred.base import defaults
from npred.lab import config

FLAGS = "-O3 -march=native -fno-math-errno -fno-trapping-math -fno-signed-zeros -freciprocal-math"
PROGRAM = r"""
#define _POSIX_C_SOURCE 199309L
#define NPRED_TEST
#define main test
#include "npred.c"
#undef main
#include <stdlib.h>
#include <time.h>

#define CALL_TIME(k) (NPRED_DT * ((double)(k) + 0.3 * (double)((k) * 7 % 11) / 11.0)) /* later by 0 to 0.27 steps */

enum { TIMED = 200000 };
static double times[TIMED];

static int order(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

int main(void)
{
    static npred_controller c;
    npred_init(&c);
    for (int k = 0; k < TIMED; k++) {
        struct timespec before, after;
        typeof(test_U[0] + 0) U[NPRED_M_INPUTS];
        clock_gettime(CLOCK_MONOTONIC, &before);
        const int code = STEP;
        clock_gettime(CLOCK_MONOTONIC, &after);
        times[k] = 1e6 * (double)(after.tv_sec - before.tv_sec) + 1e-3 * (double)(after.tv_nsec - before.tv_nsec);
        if (code) {
            return code;
        }
    }
    qsort(times, TIMED, sizeof times[0], order);
    printf("%.2f %.2f %.2f\n", times[TIMED / 2], times[TIMED * 999LL / 1000], times[TIMED - 1]);
    return 0;
}
"""


PLAIN = "npred_step(&c, test_X + k % 10 * NPRED_N_OUTPUTS, U)"  # the self-test begins with ten such calls
MEASURED = """npred_step(&c, test_X + k % TEST_ROWS * NPRED_N_STATES,
                           test_u + k % TEST_U_ROWS * NPRED_NX * NPRED_M_INPUTS, U)"""
STAMPED = """npred_step_at(&c, CALL_TIME(k), k % 10 == 9 ? NULL : test_X + k % 10 * NPRED_N_OUTPUTS,
                              CALL_TIME(k - 4), U)"""


def measure(folder: Path, flags: list[str], step: str) -> dict[str, float]:
    """Median, 99.9 % quantile and longest time of a step in µs of the files in a folder."""
    (folder / "main.c").write_text(PROGRAM.replace("STEP;", f"{step};"))
    command = ["cc", "-std=gnu99", *flags, "main.c", "-o", "main", "-lm"]
    subprocess.run(command, cwd=folder, check=True)
    output = subprocess.run(["./main"], cwd=folder, check=True, capture_output=True, text=True).stdout
    return dict(zip(("median_us", "p999_us", "max_us"), map(float, output.split()), strict=True))


def exported(arguments: list[str], store: Path, flags: list[str]) -> dict[str, float]:
    """The times of a controller that the command line exports."""
    with tempfile.TemporaryDirectory() as name:
        harness.command_line("export", "controller", *arguments, "--store", str(store), "-o", name)
        return measure(Path(name), flags, PLAIN if "history" in arguments else MEASURED)


def clocked(pipeline: str, nx: int, flags: list[str]) -> Iterator[tuple[str, dict[str, float]]]:
    """The times of controllers of the pipeline's plant with an observer of the state."""
    table = config.load(defaults.pipeline(pipeline))
    plant, dt = npred.plant(table.plant), table.evaluate.dt
    laws = {"": npred.DelayAdaptation(bounds=(0.1, 4.0)), ", DelayObserver": npred.DelayObserver(bounds=(0.1, 4.0))}
    for name, law in laws.items():
        for method in ("heun", "rk4"):
            observer = npred.observers.EKF(plant, outputs=plant.states[1:2])
            controller = npred.controller(
                plant, npred.predictor(plant, method, nx), law, dt, D_hat=2.0, actuator="history", observer=observer
            )
            for kind, step in {"EKF": PLAIN, "EKF and stamps": STAMPED}.items():
                with tempfile.TemporaryDirectory() as folder:
                    harness.sources(controller, Path(folder))
                    yield f"{method}, double, {kind}{name}", measure(Path(folder), flags, step)


def rows(model: str, nx: int) -> dict[str, list[str]]:
    """The exports that are timed."""
    pipeline = model.rpartition(":")[0]
    kinds = {"network": model, "network, guard": f"{model} --guard 0.01"}
    kinds |= {method: f"{pipeline} --predictor {method}" for method in ("heun", "rk4")}
    each = product(kinds.items(), ("double", "float"), ("measured", "history"))
    return {
        f"{kind}, {precision}, {actuator}": f"{words} --nx {nx} --precision {precision} --actuator {actuator}".split()
        for (kind, words), precision, actuator in each
    }


def main() -> None:
    options = harness.options(__doc__, {"model": ...}, store=Path("artifacts"), nx=101, flags=FLAGS, json=False)
    flags = options.flags.split()
    results = {kind: exported(words, options.store, flags) for kind, words in rows(options.model, options.nx).items()}
    results |= clocked(options.model.rpartition(":")[0], options.nx, flags)
    if options.json:
        print(json.dumps(results, indent=2))
        return
    print(f"{'µs per step':36} median   99.9 %   longest")
    for kind, times in results.items():
        print(f"{kind:36} {times['median_us']:6.2f} {times['p999_us']:8.2f} {times['max_us']:9.1f}")


if __name__ == "__main__":
    main()
