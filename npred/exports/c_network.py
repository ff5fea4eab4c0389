"""A trained operator as one self-contained C99 file, with its control law and a test vector."""

import copy
import ctypes
import tempfile
from pathlib import Path

import numpy as np

from npred.base import grid
from npred.base.errors import NpredError
from npred.exports import Exported, NetworkAlone, c_files
from npred.formulas.tape import Vector
from npred.formulas.trace import Trace
from npred.kernels.c_text import comment, constant
from npred.kernels.formula import Formulas, Strided, vector
from npred.kernels.kernel import Kernel, skeleton
from npred.loop import metrics
from npred.networks import Samples, eps
from npred.networks.fused import Loaded, fold, kernel, require
from npred.networks.weights import TrainedOperator
from npred.plants.base import Plant
from npred.prediction.delays import problem_of

TESTED = 4  # samples of the test vector
LIMIT = 1e-4  # times a state's or an input's size: the difference from the model that single precision makes


def export(of: NetworkAlone, path: Path) -> Exported:
    """Write the C file of a network, its first TESTED samples as its test vector.

    Where there is a C compiler, the file is compiled and run before it is kept. Raises NpredError for a file that
    differs from the operator in double precision by more than LIMIT of the states' and inputs' sizes, and as `source`
    does.
    """
    operator, plant, samples = of.operator, of.plant, of.samples
    X, u, D_hat, t = (a[:TESTED] for a in samples)
    text = source(operator, plant, of.nx, (X, u, D_hat, t))
    errors = None
    if c_files.compiler():
        with tempfile.TemporaryDirectory() as folder:
            trial = Path(folder) / "trial.c"
            trial.write_text(text, encoding="utf-8")
            P_hat, U_hat = _outputs(trial, plant, of.nx, samples)
        P, U, size = _expected(operator, plant, samples)
        gaps = np.concatenate([np.abs(P_hat - P).max(axis=(0, 1)), np.abs(U_hat - U).max(axis=0)])
        if not (gaps <= LIMIT * size).all():
            share = (gaps / size).max()
            raise NpredError(f"export c: expected P and U within {LIMIT:g} of their sizes, got {share:.3g}; report it")
        errors = float(gaps.max()), eps(plant, P_hat, samples)
    path.write_text(text, encoding="utf-8")
    return of.exported(path, errors)


def source(operator: TrainedOperator, plant: Plant, nx: int, samples: Samples) -> str:
    """The text of the C file; the samples become its test vector.

    Raises ConfigError for an untraced plant, for a delay that the plant declares with a law that depends on time, and
    for a network that cannot be lowered.
    """
    problem_of(plant).needs("export c")
    require(operator, "export c", "use npred export onnx")
    n, m, count = plant.n, plant.m, len(samples[0])
    sizes = {"N_STATES": n, "M_INPUTS": m, "NX": nx, "SIZE_U": nx * m, "SIZE_P": nx * n, "SAMPLES": count}
    numbers = [*(np.asarray(a, dtype=float) for a in samples), *_expected(operator, plant, samples)]
    tested = dict(zip(("X", "u", "D_hat", "t", "P", "U", "size"), numbers, strict=True))
    about = f"The trained predictor of plant {comment(plant.name)} on {nx} nodes: P_hat(x), and U = kappa(P_hat(1))."
    included = {
        "about": f" * {about}",
        "sizes": f"enum {{ {', '.join(f'{name} = {value}' for name, value in sizes.items())} }};",
        "kernels": _kernels(kernel(fold(operator, plant, nx)), plant, nx),
        "test": "\n".join(constant(f"test_{name}", values.reshape(-1)) for name, values in tested.items()),
    }
    variants = {"PHASED": plant.phased, "ONE_DELAY": plant.one_delay}
    return c_files.filled("network.c", variants=variants, included=included)


def _kernels(network: Kernel, plant: Plant, nx: int) -> str:
    """The network as loops run it here, with one lane, the law, and the plant's parameters."""
    of = Formulas(plant)
    law = of.function(*_law(of.trace, nx), {"U": plant.m}, "1").replace("{name}", "npred_law")
    p = constant("parameters", plant.p if plant.p.size else np.zeros(1))
    texts = dict.fromkeys([skeleton("base.h"), *network.texts, *of.called(), law, p])
    return "\n".join([*texts, f"#define NETWORK {network.name}", f"typedef {network.name}_memory Memory;"])


def _law(trace: Trace, nx: int) -> tuple[Vector, list[Strided | str]]:
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


def _expected(operator: TrainedOperator, plant: Plant, samples: Samples) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The model's P and U in double precision, and the size of each state and input."""
    X, u, D_hat, t = (np.asarray(a, dtype=float) for a in samples)
    P = Loaded(plant, copy.deepcopy(operator).double(), u.shape[1])(X, u, D_hat, t)
    U = plant.kappa(P[:, -1], t + D_hat) if plant.declares_delay else metrics.law(plant, P, t, D_hat)
    size = np.concatenate([np.abs(P).max(axis=(0, 1)), np.abs(U).max(axis=0)])
    return P, U, np.where(size > 0, size, 1.0)


def _outputs(path: Path, plant: Plant, nx: int, samples: Samples) -> tuple[np.ndarray, np.ndarray]:
    """P (B, nx, n) and U (B, m) of the C file. Raises NpredError where it does not compile."""
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "library.so"
        c_files.build([path], target, "c")
        library = ctypes.CDLL(str(target))
        P, U = np.empty((len(samples[0]), nx, plant.n)), np.empty((len(samples[0]), plant.m))
        for row, (X, u, D_hat, t) in enumerate(zip(*samples, strict=True)):
            X, u = np.array(X, dtype=float), np.array(u, dtype=float, order="C")
            delay, now, arrives = (ctypes.c_double(value) for value in (D_hat, t, t + D_hat))
            library.npred_predict(_at(X), _at(u), delay, *([now] if plant.phased else []), _at(P[row]))
            law = (_at(P[row, -1]), arrives) if plant.one_delay else (_at(P[row]), delay, now)
            library.npred_control(*law, _at(U[row]))
    return P, U


def _at(array: np.ndarray) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)
