"""The time of a whole control step of an exported controller in C on this machine: each step timed, in a program.

    python benchmarks/c_controller.py pipeline/paper.toml:deeponet --store artifacts

It exports the controller of the pipeline's evaluated loop with both predictors and precisions, with and without a
guard, compiles each, and runs it on the steps of its own test, over and over. The compiler's flags allow what they
allow the kernels that run here (npred.kernels.compiler.FLAGS), and NaN stays NaN.
"""

import argparse
import json
import re
import subprocess
import tempfile
from pathlib import Path

from typer.testing import CliRunner

from npred.cli import app

FLAGS = "-O3 -march=native -fno-math-errno -fno-trapping-math -fno-signed-zeros -freciprocal-math"
PROGRAM = r"""
#define _POSIX_C_SOURCE 199309L
#define NPRED_TEST
#define main test
#include "npred.c"
#undef main
#include <stdlib.h>
#include <time.h>

enum { CALLS = 200000 };
static double times[CALLS];

static int compare(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

int main(void)
{
    static npred_controller c;
    npred_init(&c);
    for (int k = 0; k < CALLS; k++) {
        struct timespec before, after;
        typeof(test_U[0] + 0) U[NPRED_M_INPUTS];
        clock_gettime(CLOCK_MONOTONIC, &before);
        const int code = npred_step(&c, test_X + k % TEST_STEPS * NPRED_N_STATES, MEASURED U);
        clock_gettime(CLOCK_MONOTONIC, &after);
        times[k] = 1e6 * (double)(after.tv_sec - before.tv_sec) + 1e-3 * (double)(after.tv_nsec - before.tv_nsec);
        if (code) {
            return code;
        }
    }
    qsort(times, CALLS, sizeof times[0], compare);
    printf("%.2f %.2f %.2f\n", times[CALLS / 2], times[CALLS * 999LL / 1000], times[CALLS - 1]);
    return 0;
}
"""


def measure(arguments: list[str], store: Path, flags: list[str]) -> dict[str, float]:
    """Median, 99.9 % quantile and longest time of a step in µs, and the size of the state in bytes."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        done = CliRunner().invoke(app, ["export", "controller", *arguments, "--store", str(store), "-o", name])
        if done.exit_code:
            raise SystemExit(done.output)
        measured = re.search(r"npred_step_nodes", (folder / "npred.h").read_text()) is not None
        u = "test_u + k % TEST_STEPS * NPRED_NX * NPRED_M_INPUTS," if measured else ""
        (folder / "main.c").write_text(PROGRAM.replace("MEASURED", u))
        command = ["cc", "-std=gnu99", *flags, "main.c", "-o", "main", "-lm"]
        subprocess.run(command, cwd=folder, check=True)
        output = subprocess.run(["./main"], cwd=folder, check=True, capture_output=True, text=True).stdout
    return dict(zip(("median_us", "p999_us", "max_us"), map(float, output.split()), strict=True))


def rows(model: str, nx: int) -> dict[str, list[str]]:
    """The exports that are timed."""
    pipeline = model.rpartition(":")[0]
    kinds = {"network": [model], "network, guard": [model, "--guard", "0.01"]}
    kinds |= {"heun": [pipeline, "--predictor", "heun"], "rk4": [pipeline, "--predictor", "rk4"]}
    return {
        f"{kind}, {precision}, {actuator}": [
            *arguments,
            "--nx",
            str(nx),
            "--precision",
            precision,
            "--actuator",
            actuator,
        ]
        for kind, arguments in kinds.items()
        for precision in ("double", "float")
        for actuator in ("measured", "history")
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("model")
    parser.add_argument("--store", type=Path, default=Path("artifacts"))
    parser.add_argument("--nx", type=int, default=101)
    parser.add_argument("--flags", default=FLAGS)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    results = {
        kind: measure(arguments, options.store, options.flags.split())
        for kind, arguments in rows(options.model, options.nx).items()
    }
    if options.json:
        print(json.dumps(results, indent=2))
        return
    print(f"{'µs per step':36} median   99.9 %   longest")
    for kind, times in results.items():
        print(f"{kind:36} {times['median_us']:6.2f} {times['p999_us']:8.2f} {times['max_us']:9.1f}")


if __name__ == "__main__":
    main()
