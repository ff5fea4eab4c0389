"""What bounds a call of a fused network: bytes, multiply-adds, or the chain of operations that wait for each other.

python benchmarks/roofline.py pipeline/paper.toml:deeponet pipeline/paper.toml:fno --nx 101 1001

For each network, of its program as the fused runtime prints it: the bytes of its constants that a call reads, its
multiply-adds, and the length of its chain. Each is divided by what one core of this machine does of it, measured here
by plain loops: bytes per second of a sum over as many bytes, multiply-adds per second of a product whose weights stay
in the nearest cache, and the seconds of one multiply-add that waits for the one before. A call takes about the longest
of the three times at least, if all overlap, and their sum if nothing does; what it takes beyond that sum goes to
inputs, running means and the call itself. The chain of a product of K terms is K multiply-adds, one after the other. An
activation counts with its scaling, polynomial and division.
"""

import argparse
import ctypes
from collections.abc import Iterable
from pathlib import Path

import numpy as np

import npred
from npred.kernels import compiler
from npred.kernels.kernel import address, bound
from npred.parallel import devices
from npred.runtimes.fused import coarsest, fold
from npred.runtimes.program import Dots, Operation, Product, Program, Repeat, Silu, SiluPair
from npred.stages.bench import timing

TERMS = 8  # of the product that is timed
SILU, PAIR = 16, 24  # operations of an activation that wait: scaling, a polynomial of five terms, a division
RUNS = 200
LATENCY, PER_CYCLE = 4, 16  # cycles of a multiply-add; how many begin per cycle, in two vectors of 256 bits


# The sum of a, again and again; out (128,) += a (8,) b (8, 128) likewise; one multiply-add after the other.
LOOPS = """
#include <stdint.h>
#pragma GCC optimize("fast-math")
float read(const float *a, int64_t size, int64_t times)
{
    float total = 0;
    for (int64_t k = 0; k < times; k++) {
        float part = 0;
        for (int64_t j = 0; j < size; j++) {
            part += a[j];
        }
        total += part * (float)k;
    }
    return total;
}
void multiply(float *restrict out, const float *restrict a, const float *restrict b, int64_t times)
{
    for (int64_t k = 0; k < times; k++) {
        for (int j = 0; j < 128; j++) {
            out[j] += (a[0] * b[j] + a[1] * b[128 + j] + a[2] * b[256 + j] + a[3] * b[384 + j]) +
                      (a[4] * b[512 + j] + a[5] * b[640 + j] + a[6] * b[768 + j] + a[7] * b[896 + j]);
        }
    }
}
__attribute__((optimize("no-fast-math"))) float chain(float x, float factor, int64_t times)
{
    for (int64_t k = 0; k < times; k++) {
        x = x * factor + factor;
    }
    return x;
}
"""


def machine(size: int) -> dict[str, float]:
    """Of one core: bytes (of `size`) and multiply-adds per µs, and the µs of a multiply-add that waits."""
    numbers, half, library = np.ones(size // 4, np.float32), ctypes.c_float(0.5), compiler.library(LOOPS)
    out, terms, weights = np.zeros(128, np.float32), np.ones(TERMS, np.float32), np.full((TERMS, 128), 1e-6, np.float32)
    passes = max(1, 400_000 // len(numbers))
    calls = {
        "bytes": lambda k: library.read(ctypes.c_void_p(address(numbers)), len(numbers), passes),
        "products": lambda k: library.multiply(*(ctypes.c_void_p(address(a)) for a in (out, terms, weights)), 1000),
        "chain": lambda k: library.chain(half, half, 20_000),
    }
    taken = timing.sample(calls, RUNS, 1.0)
    fastest = {name: samples.min() / 1000 for name, samples in taken.items()}
    return {
        "bytes": passes * numbers.nbytes / fastest["bytes"],
        "products": 1000 * weights.size / fastest["products"],
        "chain": fastest["chain"] / 20_000,
    }


def products(operations: Iterable[Operation]) -> int:
    """The multiply-adds of some operations."""
    return sum(
        operation.count * products(operation.operations) if isinstance(operation, Repeat)
        else int(np.prod(operation.shape)) * operation.repeats if isinstance(operation, Product)
        else int(np.prod(operation.shape)) if isinstance(operation, Dots) else 0
        for operation in operations
    )  # fmt: skip


def waits(operations: Iterable[Operation]) -> int:
    """The instructions of some operations that wait for each other."""
    total = 0
    for operation in operations:
        if isinstance(operation, Repeat):
            total += operation.count * waits(operation.operations)
        elif isinstance(operation, Product | Dots):
            total += operation.shape[1]
        elif isinstance(operation, Silu | SiluPair):
            total += PAIR if isinstance(operation, SiluPair) else SILU
    return total


def report(spec: str, store: str | None, nx: int) -> None:
    net = npred.load(spec, store=store, runtime="fused", nx=nx)
    p: Program = fold(net.operator, net.plant, nx, net.stride or coarsest(nx), net.precision)
    operations = [*p.operations, *([p.series.product] if p.series else [])]
    size = sum(array.nbytes for array in p.constants.values())
    does = machine(max(size, 4096))
    bounds = {
        "bytes": size / does["bytes"],
        "multiply-adds": products(operations) / does["products"],
        "chain": waits(operations) * does["chain"],
    }
    median, longest = measured(net, nx), max(bounds, key=lambda name: bounds[name])
    whole = sum(bounds.values())
    print(f"{spec}, nx = {nx}: {size / 1000:.0f} kB, {products(operations) / 1000:.0f} thousand multiply-adds, "
          f"{waits(operations)} operations in a chain")  # fmt: skip
    peak = PER_CYCLE * LATENCY / (1000 * does["chain"])
    print(f"  this core: {does['bytes'] / 1000:.0f} GB/s, {does['products'] / 1000:.0f} G multiply-adds/s (its units: "
          f"{peak:.0f}), {1000 * does['chain']:.2f} ns for one that waits")  # fmt: skip
    print("  " + ", ".join(f"{name} {us:.2f} µs" for name, us in bounds.items()) + f"; sum {whole:.2f}; measured "
          f"{median:.2f} µs: {median / bounds[longest]:.1f} times {longest}, {median / whole:.1f} times the sum",
          flush=True)  # fmt: skip


def measured(net: npred.Predictor, nx: int) -> float:
    """The median microseconds of a call."""
    X = np.array([[low] for low, _ in net.plant.box.values()])
    u, P = np.zeros((nx, net.plant.m, 1)), np.empty((nx, net.plant.n, 1))
    predict = bound(net.lanes(), X, u, np.ones(1), 0.0, net.plant.p, P)
    taken = timing.sample({"call": lambda k: predict()}, 20_000, 3.0)
    return timing.quantiles(taken["call"])["median_us"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("models", nargs="+")
    parser.add_argument("--store", default=None)
    parser.add_argument("--nx", type=int, nargs="+", default=[101])
    arguments = parser.parse_args()
    print(devices.hardware("cpu")["cpu"])
    for spec in arguments.models:
        for nx in arguments.nx:
            report(spec, arguments.store and str(Path(arguments.store)), nx)


if __name__ == "__main__":
    main()
