"""A trained operator as one self-contained C99 file, with its control law and a test vector."""

import copy
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch

from npred import grid
from npred.delays import family_of
from npred.errors import NpredError
from npred.loop import metrics
from npred.operators import Operator
from npred.plants.base import Plant
from npred.runtimes import c_library, c_text
from npred.runtimes.lower import fold, require
from npred.runtimes.probe import Probe, eps
from npred.runtimes.program import Program, indented
from npred.symbolic import kernels

TESTED = 4  # samples of the test vector
LIMIT = 1e-4  # of a state's or an input's size: the difference from the model that single precision makes

SOURCE = """\
{title}
 *
 * C99, no library but libm, no allocation. Its memory is static: one call at a time.
 * npred_predict: state X, actuator state u by nodes x = j / (NX - 1) and inputs, D_hat in seconds; writes P likewise.
 {reads}
 * With -DNPRED_TEST it is a program that compares itself with the model it was made from.
 */
#include <math.h>

{sizes}

{prototypes}

{constants}

{buffers}
static double prefix[NX];

{functions}

static void inputs(const double *X, const double *u, double D_hat)
{
    for (int c = 0; c < N_STATES; c++) {
        z[c] = (float)((asinh(X[c] * X_bend[c]) - X_zero[c]) * X_gain[c]);
    }
    z[SEEN] = (float)((D_hat - D_hat_zero[0]) * D_hat_gain[0]);
    for (int c = 0; c < M_INPUTS; c++) {
        double total = 0;
        for (int j = 0; j < NX; j++) {
            v[j * M_INPUTS + c] = (float)((u[j * M_INPUTS + c] - u_zero[c]) * u_gain[c]);
            total += (double)v[j * M_INPUTS + c];
            prefix[j] = 2 * total - (double)v[c] - (double)v[j * M_INPUTS + c];
        }
        r[c * NX] = v[c];
        for (int j = 1; j < NX; j++) {
            r[c * NX + j] = (float)(prefix[j] / (2 * j));
        }
    }
}

static void network(void)
{
    {steps}
}

{predict_head}
{
    {predict}
    for (int c = 0; c < N_STATES; c++) {
        for (int j = 0; j < NX; j++) {
            const double change = (double)(gain[c * NX + j] * N[c * NX + j]);
            {output}
        }
    }
}

{control}

#ifdef NPRED_TEST
#include <stdio.h>

{vector}

int main(void)
{
    static double P[SIZE_P];
    double U[M_INPUTS], worst = 0;
    for (int s = 0; s < SAMPLES; s++) {
        {calls}
        for (int k = 0; k < SIZE_P; k++) {
            worst = fmax(worst, fabs(P[k] - test_P[s * SIZE_P + k]) / test_size[k % N_STATES]);
        }
        for (int k = 0; k < M_INPUTS; k++) {
            worst = fmax(worst, fabs(U[k] - test_U[s * M_INPUTS + k]) / test_size[N_STATES + k]);
        }
    }
    printf("largest difference: %.2e of each state's size\\n", worst);
    return !(worst <= 1e-5);
}
#endif
"""

SILU = """\
static void silu(const float *a, int count, float *out)
{
    for (int j = 0; j < count; j++) {
        out[j] = a[j] / (1.0f + expf(-a[j]));
    }
}"""

# silu(b) - silu(a) and silu(a) of rows (b - a, a): nothing cancels where b - a is small
SILU_PAIR = """\
static void silu_pair(const float *a, int count, float *out)
{
    for (int j = 0; j < count; j++) {
        const float d = a[j], rest = a[count + j];
        const float s_rest = 1.0f / (1.0f + expf(-rest)), s = 1.0f / (1.0f + expf(-rest - d));
        out[count + j] = rest * s_rest;
        out[j] = d * s + rest * (fabsf(d) < 0.5f ? s_rest * (1.0f - s) * expm1f(d) : s - s_rest);
    }
}"""

PLAIN = """\
inputs(X, u, D_hat);
network();"""

PAIR = """\
inputs(X, u, D_hat);
for (int c = N_STATES; c <= SEEN; c++) {
    z[SEEN + 1 + c] = z[c];
    z[c] = 0;
}
network();"""

PHASE = """\
const double angle = 2 * PI * (t / PERIOD - floor(t / PERIOD));
z[N_STATES] = (float)cos(angle);
z[N_STATES + 1] = (float)sin(angle);"""

# The law of one delay reads a state, that of several each input's own.
CONTROL = """\
void npred_control(const double X[N_STATES], double t, double U[M_INPUTS])
{
    (void)X;
    (void)t;
    {law}
}"""

READS = """\
* npred_control: the control law at a state, that is P's last row, and at the time t when U arrives, now + D_hat, in
* seconds; writes U, without bounds."""

SEVERAL = """\
void npred_control(const double P[SIZE_P], double D_hat, double t, double U[M_INPUTS])
{
    const double now = t;
    (void)D_hat;
    (void)now;
    {laws}
}"""

SEVERAL_READS = """\
* npred_control: U_j = kappa_j(P(r_j), t + r_j D_hat) for the shares r_j of the longest delay, P cubic between nodes, t
* the time now in seconds; writes U, without bounds."""

# Inside the series' range one pass is enough; outside it the point of rest has a separate pass, before the sample's.
SERIES = """\
const double s = (D_hat - series_range[0]) * series_range[1] - 1;
inputs(X, u, D_hat);
if (fabs(s) <= 1) {
    double one = 1, two = s;
    for (int k = 0; k < TERMS; k++) {
        const double three = 2 * s * two - one;
        T[k] = (float)one;
        one = two;
        two = three;
    }
    {series}
} else {
    {rest}
}
{difference}"""

REST = """\
for (int c = 0; c < N_STATES; c++) {
    z[c] = 0;
}
for (int k = 0; k < SIZE_U; k++) {
    r[k] = 0;
}
network();
for (int k = 0; k < SIZE_P; k++) {
    N_rest[k] = N[k];
}
inputs(X, u, D_hat);"""

DIFFERENCE = """\
network();
for (int k = 0; k < SIZE_P; k++) {
    N[k] -= N_rest[k];
}"""


def export(operator: Operator, plant: Plant, path: Path, nx: int, samples: Probe) -> tuple[float, float] | None:
    """Write the C file for nx nodes, its first TESTED samples as its test vector.

    Returns the largest difference of P and U from the operator's in double precision, and eps of npred.runtimes.probe:
    the file is compiled and run before it is kept. None where there is no C compiler. Raises NpredError for a file that
    differs by more than LIMIT of the states' and inputs' sizes, and as `source` does.
    """
    text = source(operator, plant, nx, tuple(a[:TESTED] for a in samples))  # type: ignore[arg-type]
    errors = None
    if c_library.compiler():
        with tempfile.TemporaryDirectory() as folder:
            trial = Path(folder) / "trial.c"
            trial.write_text(text, encoding="utf-8")
            errors = _errors(operator, plant, samples, *c_library.outputs(trial, plant, nx, samples))
    path.write_text(text, encoding="utf-8")
    return errors


def _errors(
    operator: Operator, plant: Plant, samples: Probe, P_hat: np.ndarray, U_hat: np.ndarray
) -> tuple[float, float]:  # fmt: skip
    P, U, size = _expected(operator, plant, samples)
    gaps = np.concatenate([np.abs(P_hat - P).max(axis=(0, 1)), np.abs(U_hat - U).max(axis=0)])
    if not (gaps <= LIMIT * size).all():
        share = (gaps / size).max()
        raise NpredError(f"export c: expected P and U within {LIMIT:g} of their sizes, got {share:.3g}; report it")
    return float(gaps.max()), eps(plant, P_hat, samples)


def source(operator: Operator, plant: Plant, nx: int, samples: Probe) -> str:
    """The text of the C file; the samples become its test vector.

    Raises ConfigError for an untraced plant, for a delay that the plant declares with a law that depends on time, and
    for a network that cannot be lowered.
    """
    family_of(plant).needs("export c")
    require(operator, "export c", "use npred export onnx")
    p = fold(operator, plant, nx)
    sizes = {
        "N_STATES": p.n,
        "M_INPUTS": p.m,
        "NX": nx,
        "SIZE_U": nx * p.m,
        "SIZE_P": nx * p.n,
        "SEEN": p.seen,
        "SAMPLES": len(samples[0]),
    }
    if p.series:
        sizes["TERMS"] = p.series.terms
        p.scale("series_range", np.array([p.series.low, 2 / (p.series.high - p.series.low)]))
    return kernels.fill(
        SOURCE,
        title=[
            f"/* The trained predictor of plant {c_text.comment(plant.name)} on {nx} nodes: P_hat(x), and "
            "U = kappa(P_hat(1))."
        ],
        sizes=[f"enum {{ {', '.join(f'{name} = {value}' for name, value in sizes.items())} }};", *_period(p)],
        reads=(READS if plant.one_delay else SEVERAL_READS).splitlines(),
        prototypes=[f"{head};" for head in (_head(p), _control(plant, nx)[0])],
        predict_head=[_head(p)],
        control=_control(plant, nx),
        calls=_calls(p, plant),
        constants=[c_text.constant(name, values) for name, values in p.constants.items()],
        buffers=[f"static float {name}[{size}];" for name, size in p.buffers.items()],
        functions=(SILU_PAIR if p.rows == 2 else SILU).splitlines(),
        steps=c_text.steps(p.steps),
        predict=[*(PHASE.splitlines() if p.period else []), *_predict(p)],
        output=[f"P[j * N_STATES + c] = {'base[c] +' if 'base' in p.constants else 'X[c] + D_hat *'} change;"],
        vector=_vector(operator, plant, samples),
    )


def _predict(p: Program) -> Sequence[str]:
    rest, difference = REST.splitlines(), DIFFERENCE.splitlines()
    if p.series:
        series = c_text.steps([p.series.product])
        return kernels.fill(SERIES, series=series, rest=rest, difference=difference).splitlines()
    if p.twice:
        return ["inputs(X, u, D_hat);", *rest, *difference]
    return (PAIR if p.rows == 2 else PLAIN).splitlines()


def _period(p: Program) -> list[str]:
    """The constants of the phase."""
    return [f"#define {name} {value!r}" for name, value in (("PI", np.pi), ("PERIOD", p.period))] if p.period else []


def _head(p: Program) -> str:
    """The head of npred_predict, which takes the time where the network sees it."""
    time = ", double t" if p.period else ""
    return f"void npred_predict(const double X[N_STATES], const double u[SIZE_U], double D_hat{time}, double P[SIZE_P])"


def _control(plant: Plant, nx: int) -> list[str]:
    """The lines of npred_control."""
    if plant.one_delay:
        return kernels.fill(CONTROL, law=c_text.control_law(plant)).splitlines()
    laws = []
    firsts, weights = grid.stencil(nx, plant.ratios)
    for j, (first, ratio) in enumerate(zip(firsts.tolist(), plant.ratios.tolist(), strict=True)):
        nodes = [f"{w!r} * P[{first + k} * N_STATES + {{c}}]" for k, w in enumerate(weights[:, j].tolist()) if w]
        state = ", ".join(" + ".join(nodes).format(c=c) for c in range(plant.n))
        arguments = [f"const double X[N_STATES] = {{{state}}};", f"const double t = now + {ratio!r} * D_hat;"]
        laws += ["{", *indented([*arguments, "(void)X;", "(void)t;", *c_text.control_law(plant, j)]), "}"]
    return kernels.fill(SEVERAL, laws=laws).splitlines()


def _calls(p: Program, plant: Plant) -> list[str]:
    """The calls of the self-test."""
    time = ", test_t[s]" if p.period else ""
    end = "P + (NX - 1) * N_STATES, test_t[s] + test_D_hat[s]" if plant.one_delay else "P, test_D_hat[s], test_t[s]"
    return [
        f"npred_predict(test_X + s * N_STATES, test_u + s * SIZE_U, test_D_hat[s]{time}, P);",
        f"npred_control({end}, U);",
    ]


@torch.no_grad()
def _expected(operator: Operator, plant: Plant, samples: Probe) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The model's P and U in double precision, and the size of each state and input."""
    X, u, D_hat, t = (np.asarray(a, dtype=float) for a in samples)
    model = copy.deepcopy(operator).double()
    phase = (torch.as_tensor(plant.phase(t)),) if plant.phased else ()
    P = model(torch.as_tensor(X), torch.as_tensor(u), torch.as_tensor(D_hat), *phase).numpy()
    U = plant.kappa(P[:, -1], t + D_hat) if plant.declares_delay else metrics.law(plant, P, t, D_hat)
    size = np.concatenate([np.abs(P).max(axis=(0, 1)), np.abs(U).max(axis=0)])
    return P, U, np.where(size > 0, size, 1.0)


def _vector(operator: Operator, plant: Plant, samples: Probe) -> list[str]:
    """The test vector: the samples, and what is expected of them."""
    columns = zip(("X", "u", "D_hat", "t"), (np.asarray(a, dtype=float) for a in samples), strict=True)
    arrays = dict(columns) | dict(zip(("P", "U", "size"), _expected(operator, plant, samples), strict=True))
    return [c_text.constant(f"test_{name}", values.reshape(-1)) for name, values in arrays.items()]
