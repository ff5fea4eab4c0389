"""A trained operator as one self-contained C99 file, with its control law and a test vector."""

import copy
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import torch

from npred import grid
from npred.delays import family_of
from npred.errors import NpredError
from npred.kernels.c_text import comment, constant, fill
from npred.kernels.formula import vector
from npred.kernels.functions import Formulas
from npred.kernels.kernel import Kernel, skeleton
from npred.loop import metrics
from npred.operators import Operator
from npred.plants.base import Plant
from npred.runtimes import c_library
from npred.runtimes.fused import fold, kernel, require
from npred.runtimes.probe import Probe, eps
from npred.runtimes.program import Program
from npred.symbolic.trace import Trace

TESTED = 4  # samples of the test vector
LIMIT = 1e-4  # of a state's or an input's size: the difference from the model that single precision makes

SOURCE = """\
{title}
 *
 * C99, no library but libm, no allocation. Its memory is static: one call at a time.
 * npred_predict: state X, actuator state u by nodes x = j / (NX - 1) and inputs, D_hat; writes P likewise.
 {reads}
 * With -DNPRED_TEST it is a program that compares itself with the model it was made from.
 */
{sizes}

{prototypes}

{kernels}

{predict_head}
{
    static NETWORK_memory memory;
    const Shape shape = {NX, 1, 0, N_STATES, M_INPUTS};
    NETWORK(shape, X, u, &D_hat, TIME, parameters, P, (double *)&memory);
}

{control_head}
{
    npred_law(ARGUMENTS, parameters, U);
}

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

CONTROL = "void npred_control(const double X[N_STATES], double t, double U[M_INPUTS])"
SEVERAL = "void npred_control(const double P[SIZE_P], double D_hat, double t, double U[M_INPUTS])"
READS = """\
* npred_control: the control law at a state, that is P's last row, and at the time t when U arrives, now + D_hat;
* writes U, without bounds."""

SEVERAL_READS = """\
* npred_control: U_j = kappa_j(P(r_j), t + r_j D_hat) for the shares r_j of the longest delay, P cubic between nodes, t
* the time now; writes U, without bounds."""


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
        "N_STATES": p.n, "M_INPUTS": p.m, "NX": nx, "SIZE_U": nx * p.m, "SIZE_P": nx * p.n, "SAMPLES": len(samples[0]),
    }  # fmt: skip
    network = kernel(p)
    predict, control = _head(p), CONTROL if plant.one_delay else SEVERAL
    slots = {"NETWORK": network.name, "TIME": "t" if p.period else "0", "ARGUMENTS": _passed(plant)}
    text = SOURCE
    for slot, words in slots.items():
        text = text.replace(slot, words)
    return fill(
        text,
        title=[
            f"/* The trained predictor of plant {comment(plant.name)} on {nx} nodes: P_hat(x), and U = kappa(P_hat(1))."
        ],
        sizes=[f"enum {{ {', '.join(f'{name} = {value}' for name, value in sizes.items())} }};"],
        reads=(READS if plant.one_delay else SEVERAL_READS).splitlines(),
        prototypes=[f"{head};" for head in (predict, control)],
        kernels=_kernels(network, plant, nx).splitlines(),
        predict_head=[predict],
        control_head=[control],
        calls=_calls(p, plant),
        vector=_vector(operator, plant, samples),
    )


def _kernels(network: Kernel, plant: Plant, nx: int) -> str:
    """The network as loops run it here, with one lane, the law, and the plant's parameters."""
    of = Formulas(plant)
    law = of.function(*_law(of.trace, nx), {"U": plant.m}, "1").replace("{name}", "npred_law")
    p = constant("parameters", plant.p if plant.p.size else np.zeros(1))
    texts = [skeleton("base.h"), *network.texts, *of.called(), law, p]
    return "\n".join(["#define WIDE 1", "#define LANES", "#define INDEX int", *dict.fromkeys(texts)])


def _law(trace: Trace, nx: int) -> tuple[list[Any], list[Any]]:
    """U and the arguments that it is of: a state and a time, or, for several delays, P on the nodes, D_hat and t.

    Each component of several is kappa at its own state, P at r_j, cubic between nodes.
    """
    plant, t = trace.plant, trace.input("t")
    if plant.one_delay:
        return [*trace.kappa(trace.vector("x", plant.n), t)], [vector("X", plant.n, "1", "x"), "t"]
    P, D_hat = trace.vector("P", nx * plant.n).reshape(nx, plant.n), trace.input("D_hat")
    firsts, weights = grid.stencil(nx, plant.ratios)
    U = []
    for j, ratio in enumerate(plant.ratios.tolist()):
        x = weights[:, j] @ P[firsts[j] : firsts[j] + len(weights)]
        U.append(trace.kappa(x, t + ratio * D_hat)[j])
    return U, [vector("P", nx * plant.n, "1"), "D_hat", "t"]


def _passed(plant: Plant) -> str:
    return "X, t" if plant.one_delay else "P, D_hat, t"


def _head(p: Program) -> str:
    """The head of npred_predict, which takes the time where the network sees it."""
    time = ", double t" if p.period else ""
    return f"void npred_predict(const double X[N_STATES], const double u[SIZE_U], double D_hat{time}, double P[SIZE_P])"


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
    return [constant(f"test_{name}", values.reshape(-1)) for name, values in arrays.items()]
