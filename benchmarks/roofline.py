"""What bounds a call of a fused network: bytes, multiply-adds, or the chain of operations that wait for each other.

python benchmarks/roofline.py pipeline/paper.toml:deeponet pipeline/paper.toml:fno --nx 101 1001

For each network, of its program as the fused runtime prints it: the bytes of its constants that a call reads, its
multiply-adds, and the length of its chain. Each is divided by what one core of this machine does of it, measured here
by plain loops: bytes per second of a sum over as many bytes, and the seconds of one multiply-add that waits for the one
before, in which PER_CYCLE times LATENCY others could be done. A call takes about the longest of the three times at
least, if all overlap, and their sum if nothing does; what it takes beyond that sum goes to inputs, running means and
the call itself. The chain of a product of K terms is K multiply-adds, one after the other. An activation counts with
its scaling, polynomial and division.
"""

import ctypes
from collections.abc import Iterable

import harness
import numpy as np

import npred
from npred.base import devices
from npred.kernels import compiler
from npred.kernels.kernel import address, bound
from npred.lab.stages.bench import timing
from npred.networks.fused import coarsest, fold
from npred.networks.program import Dots, Operation, Product, Program, Repeat, Silu, SiluPair

SILU, PAIR = 16, 24  # operations of an activation that wait: scaling, a polynomial of five terms, a division
RUNS = 200
LATENCY, PER_CYCLE = 4, 16  # cycles of a multiply-add; how many begin per cycle, in two vectors of 256 bits


# A sum of whole numbers, which a compiler may add in any order, again and again; one multiply-add after the other.
LOOPS = """
#include <stdint.h>
int32_t read(const int32_t *a, int64_t size, int64_t times)
{
    int32_t total = 0;
    for (int64_t k = 0; k < times; k++) {
        int32_t part = 0;
        for (int64_t j = 0; j < size; j++) {
            part += a[j];
        }
        total += part * (int32_t)k;
    }
    return total;
}
float chain(float x, float factor, int64_t times)
{
    for (int64_t k = 0; k < times; k++) {
        x = x * factor + factor;
    }
    return x;
}
"""


def machine(size: int) -> dict[str, float]:
    """Of one core: bytes (of `size`) and multiply-adds per µs, and the µs of a multiply-add that waits."""
    numbers, half, library = np.ones(size // 4, np.int32), ctypes.c_float(0.5), compiler.library(LOOPS)
    passes = max(1, 400_000 // len(numbers))
    calls = {
        "bytes": lambda k: library.read(ctypes.c_void_p(address(numbers)), len(numbers), passes),
        "chain": lambda k: library.chain(half, half, 20_000),
    }
    taken = timing.sample(calls, RUNS, 1.0)
    fastest = {name: samples.min() / 1000 for name, samples in taken.items()}
    chain = fastest["chain"] / 20_000
    return {
        "bytes": passes * numbers.nbytes / fastest["bytes"], "products": PER_CYCLE * LATENCY / chain, "chain": chain,
    }  # fmt: skip


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
    return sum(
        operation.count * waits(operation.operations) if isinstance(operation, Repeat)
        else operation.shape[1] if isinstance(operation, Product | Dots)
        else PAIR if isinstance(operation, SiluPair)
        else SILU if isinstance(operation, Silu) else 0
        for operation in operations
    )  # fmt: skip


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
    print(f"  this core: {does['bytes'] / 1000:.0f} GB/s, {does['products'] / 1000:.0f} G multiply-adds/s, "
          f"{1000 * does['chain']:.2f} ns for one that waits")  # fmt: skip
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


if __name__ == "__main__":
    arguments = harness.options(__doc__, {"models": []}, store=str, nx=[101])
    print(devices.hardware("cpu")["cpu"])
    for spec in arguments.models:
        for nx in arguments.nx:
            report(spec, arguments.store, nx)
