"""A trained operator as one self-contained C99 file, with its control law and a test vector."""

import copy
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch

from npred.delays import family_of
from npred.operators import Operator
from npred.plants.base import Plant
from npred.runtimes import c_text
from npred.runtimes.lower import fold, require
from npred.runtimes.program import Program
from npred.symbolic import kernels

SOURCE = """\
{title}
 *
 * C99, no library but libm, no allocation. Its memory is static: one call at a time.
 * npred_predict: state X, actuator state u by nodes x = j / (NX - 1) and inputs, D_hat in seconds; writes P likewise.
 * npred_control: the control law at a state, that is P's last row, and at the time t when U arrives, now + D_hat, in
 * seconds; writes U, without bounds.
 * With -DNPRED_TEST it is a program that compares itself with the model it was made from.
 */
#include <math.h>

{sizes}

void npred_predict(const double X[N_STATES], const double u[SIZE_U], double D_hat, double P[SIZE_P]);
void npred_control(const double X[N_STATES], double t, double U[M_INPUTS]);

{constants}

{buffers}
static double prefix[NX];

{functions}

static void inputs(const double *X, const double *u, double D_hat)
{
    for (int c = 0; c < N_STATES; c++) {
        z[c] = (float)((asinh(X[c] * X_bend[c]) - X_zero[c]) * X_gain[c]);
    }
    z[N_STATES] = (float)((D_hat - D_hat_zero[0]) * D_hat_gain[0]);
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

void npred_predict(const double X[N_STATES], const double u[SIZE_U], double D_hat, double P[SIZE_P])
{
    {predict}
    for (int c = 0; c < N_STATES; c++) {
        for (int j = 0; j < NX; j++) {
            const double change = (double)(gain[c * NX + j] * N[c * NX + j]);
            {output}
        }
    }
}

void npred_control(const double X[N_STATES], double t, double U[M_INPUTS])
{
    (void)X;
    (void)t;
    {law}
}

#ifdef NPRED_TEST
#include <stdio.h>

{vector}

int main(void)
{
    static double P[SIZE_P];
    double U[M_INPUTS], worst = 0;
    for (int s = 0; s < SAMPLES; s++) {
        npred_predict(test_X + s * N_STATES, test_u + s * SIZE_U, test_D_hat[s], P);
        npred_control(P + (NX - 1) * N_STATES, test_D_hat[s], U);
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
z[2 * N_STATES + 1] = z[N_STATES];
z[N_STATES] = 0;
network();"""

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
    inputs(X, u, D_hat);
}
network();
for (int k = 0; k < SIZE_P; k++) {
    N[k] -= N_rest[k];
}"""


def export(operator: Operator, plant: Plant, path: Path, nx: int, probe: tuple[np.ndarray, ...]) -> None:
    """Write the C file for nx nodes; `probe`, X (B, n), u (B, nx, m), D_hat (B,), becomes its test vector."""
    path.write_text(source(operator, plant, nx, probe), encoding="utf-8")


def source(operator: Operator, plant: Plant, nx: int, probe: tuple[np.ndarray, ...]) -> str:
    """The text of the C file.

    Raises ConfigError where inputs have several delays, for its kappa reads P(1) alone, for an untraced plant, and
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
        "SAMPLES": len(probe[0]),
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
        sizes=[f"enum {{ {', '.join(f'{name} = {value}' for name, value in sizes.items())} }};"],
        constants=[c_text.constant(name, values) for name, values in p.constants.items()],
        buffers=[f"static float {name}[{size}];" for name, size in p.buffers.items()],
        functions=(SILU_PAIR if p.rows == 2 else SILU).splitlines(),
        steps=c_text.steps(p.steps),
        predict=_predict(p),
        output=[f"P[j * N_STATES + c] = {'base[c] +' if 'base' in p.constants else 'X[c] + D_hat *'} change;"],
        law=c_text.control_law(plant),
        vector=_vector(operator, plant, probe),
    )


def _predict(p: Program) -> Sequence[str]:
    if p.series:
        return kernels.fill(SERIES, series=c_text.steps([p.series.product])).splitlines()
    return (PAIR if p.rows == 2 else PLAIN).splitlines()


@torch.no_grad()
def _vector(operator: Operator, plant: Plant, probe: tuple[np.ndarray, ...]) -> list[str]:
    """The test vector: inputs, the model's P and U in double precision, and the size of each state and input."""
    X, u, D_hat = (np.asarray(a, dtype=float) for a in probe)
    model = copy.deepcopy(operator).double()
    P = model(torch.as_tensor(X), torch.as_tensor(u), torch.as_tensor(D_hat)).numpy()
    U = plant.kappa(P[:, -1], D_hat)
    size = np.concatenate([np.abs(P).max(axis=(0, 1)), np.abs(U).max(axis=0)])
    arrays = {"X": X, "u": u, "D_hat": D_hat, "P": P, "U": U, "size": np.where(size > 0, size, 1.0)}
    return [c_text.constant(f"test_{name}", values.reshape(-1)) for name, values in arrays.items()]
