"""The time of a step of the exported safety filter, beside the bound that its header counts, and its memory.

    python benchmarks/protect.py

The filter is compiled by gcc -O2, and called alone: with states that it acts on, near and far, with other margins and
bounds of U, each with the memory that a loop has there (npred.exports.filter_test). Times are of the processor, the
least of RUNS of each call: the median and the longest of the calls. The bound is the counted number of operations at
the rate of sums of products of 1000 numbers.
"""

import re
import subprocess
import tempfile
from pathlib import Path
from typing import Any

import harness
import limited
import numpy as np
from plants import declared

import npred
from npred.exports import c_controller, filter_test
from npred.kernels.c_text import constant
from npred.plants import Plant

PROGRAM = r"""
#define _POSIX_C_SOURCE 199309L
#include "npred.c"
#include "calls.h"
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

enum { RUNS = 3, N = NPRED_N_STATES, M = NPRED_M_INPUTS, MANY = 1000, TIMES = 10000 };
static double times[COUNT], safety[sizeof the_safety / sizeof *the_safety], numbers[MANY];
static npred_controller c;

static double now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
    return 1e3 * (double)t.tv_sec + 1e-6 * (double)t.tv_nsec;
}

static int order(const void *a, const void *b)
{
    return (*(const double *)a > *(const double *)b) - (*(const double *)a < *(const double *)b);
}

int main(void)
{
    volatile double sum = 0.0;
    for (int k = 0; k < COUNT * RUNS; k++) {
        const double *margin = given + k % COUNT * GIVEN, *low = margin + 1, *ends = low + 2 * M;
        const double *moments = ends + NPRED_ENDS * N;
        double U[M], plan[NPRED_PLAN], results[5] = {0.0};
        memcpy(U, moments + NPRED_ENDS, sizeof U);
        memcpy(plan, moments + NPRED_ENDS + M, sizeof plan);
        memcpy(safety, the_safety, sizeof safety);
        safety[N] = *margin;
        const double begin = now();
        the_parts.protect(the_shape, ends, moments, the_settings.p, safety, low, low + M, U, plan, results, results + 1,
                          results + 2, results + 3, results + 4, c.work);
        const double took = now() - begin;
        times[k % COUNT] = k < COUNT ? took : fmin(took, times[k % COUNT]);
    }
    qsort(times, COUNT, sizeof *times, order);
    const double begin = now();
    for (int k = 0; k < TIMES; k++) {
        double one = 0.0;
        for (int i = 0; i < MANY; i++) {
            one += numbers[i] * numbers[i];
        }
        sum += one;
        numbers[k % MANY] = 1.0 / (1.0 + k);
    }
    printf("%.17g %.17g %.17g\n", times[COUNT / 2], times[COUNT - 1], 2.0 * MANY * TIMES / (now() - begin));
    return 0;
}
"""


def rods(x: Any, u: Any, t: Any, p: Any, M: Any) -> list[Any]:
    """Two of 1 kg and 0.5 m, their angles to the vertical, friction 0.1."""
    c, s = 0.125 * M.cos(x[0] - x[1]), 0.125 * M.sin(x[0] - x[1])
    first = u[0] - u[1] - 0.1 * x[2] - s * x[3] ** 2 - 7.3575 * M.sin(x[0])
    second = u[1] - 0.1 * x[3] + s * x[2] ** 2 - 2.4525 * M.sin(x[1])
    whole = 1 / 36 - c * c
    return [x[2], x[3], (first / 12 - c * second) / whole, (second / 3 - c * first) / whole]


def reached(x: Any, t: Any, p: Any, M: Any) -> list[Any]:
    second = 2.4525 * M.sin(x[1]) - 2 * (x[1] - 1.0) - 0.8 * x[3]
    return [7.3575 * M.sin(x[0]) - 8 * (x[0] - 0.6) - 3 * x[2] + second, second]


Rods = declared(  # sent beyond both stops
    "Rods", "a b va vb", "p q", rods, [(-0.4, 0.4), (-0.2, 0.8), (-0.8, 0.8), (-0.8, 0.8)], (-20.0, 20.0), (-8.0, 8.0),
    kappa=reached, guess=(0.6, 1.0, 0.0, 0.0),
    safe=lambda x, t, p, M: [
        0.5 - x[0], x[0] + 0.5, 0.9 - x[1], x[1] + 0.3, 1.0 - x[2], 1.0 + x[2], 1.0 - x[3], 1.0 + x[3]
    ],
)  # fmt: skip


def joints(count: int) -> Plant:
    """So many joints with stops and limits of their speeds, sent beyond the stops."""
    states = " ".join(f"{name}{i}" for name in "qw" for i in range(count))
    return npred.plant(declared(
        "Joints", states, " ".join(f"T{i}" for i in range(count)),
        lambda x, u, t, p, M: [*x[count:], *u], [(-0.5, 0.5)] * 2 * count, *[(-5.0, 5.0)] * count,
        kappa=lambda x, t, p, M: [-4 * (x[i] - 1.2) - 3 * x[count + i] for i in range(count)],
        safe=lambda x, t, p, M: [
            b - s * x[o + i] for o, b in ((0, 1.0), (count, 0.8)) for s in (1, -1) for i in range(count)
        ],
    ))  # fmt: skip


def measured(plant: Plant, delay: float, dt: float, starts: int) -> list[str]:
    """A row of the table."""
    kept = npred.SafetyFilter(delay=delay)
    controller = npred.controller(
        plant, npred.predictor(plant, "rk4", 31), None, dt, D_hat=0.05, actuator="history", safety=kept
    )
    filter_test.STARTS, c_controller._test = starts, lambda *of: ""
    exactly, m = filter_test._called(controller, np.float64, np.float64), plant.m
    given = [given for given, answer in filter_test._met(controller, exactly, np.float64) if answer[m] > 0]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        harness.sources(controller, folder)
        (folder / "calls.h").write_text(
            f"enum {{ COUNT = {len(given)}, GIVEN = {len(given[0])} }};\n{constant('given', np.ravel(given))}"
        )
        (folder / "main.c").write_text(PROGRAM)
        subprocess.run(["gcc", "-std=gnu99", "-O2", "main.c", "-o", "main", "-lm"], cwd=folder, check=True)
        median, longest, rate = map(float, subprocess.run(["./main"], cwd=folder, stdout=-1, check=True).stdout.split())
        taken = re.findall(r"takes (\d+) bytes", (folder / "npred.h").read_text())[0]
    counted = kept.operations(plant)
    ratio = counted / rate / longest
    shown = (
        f"{median:.3f}",
        f"{longest:.3f}",
        f"{longest / median:.1f}",
        f"{counted / 1e6:.2g}",
        f"{counted / rate:.2g}",
    )
    return [str(len(given)), *shown, f"{ratio:.1f}", f"{int(taken) / 1e3:.0f}"]


if __name__ == "__main__":
    harness.options(__doc__)
    near = limited.mass(0.95, lambda x, t, p, M: [1 - x.x, 1 + x.x, 1 - x.v, 1 + x.v], (-0.9, 0.9), (-0.9, 0.9))
    two, seven = npred.plant(Rods), joints(7)
    harness.head("a filter", "calls", "median", "longest, ms", "ratio", "counted, 10^6", "bound, ms", "ratio", "kB")
    harness.row("1 input, 4 limits", *measured(near, 0.0, 0.001, 96))
    harness.row("2 joints, 8 limits", *measured(two, 0.0, 0.001, 96))
    harness.row("the same, D ± 10 ms", *measured(two, 0.01, 0.001, 96))
    harness.row("7 joints, 28 limits", *measured(seven, 0.0, 0.01, 12))
