"""A network as a function of numbers: matrices, and formulas of single numbers, one after the other on slots of memory.

Slots hold the inputs, then what each part gives. A trace calls it by name, and so do its kernels: see
npred.kernels.network. The name has the digest of all numbers in it, so that texts and keys change with the weights.
"""

import hashlib
import importlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from numbers import Real
from typing import Any, NamedTuple

import numpy as np

from npred.formulas import Array, Value, array_math, programs
from npred.formulas.tape import M, Symbol, Tape
from npred.formulas.trace import python

# By ONNX's names. A kink has the derivative that PyTorch gives it: Relu 0, the others that of their left side.
FORMULAS: dict[str, Callable[..., Value]] = {
    "Add": lambda M, a, b: a + b,
    "Sub": lambda M, a, b: a - b,
    "Mul": lambda M, a, b: a * b,
    "Div": lambda M, a, b: a / b,
    "Pow": lambda M, a, b: a**b,
    "Neg": lambda M, a: -a,
    "Identity": lambda M, a: a,
    "Relu": lambda M, a: M.maximum(a, 0.0),
    "LeakyRelu": lambda M, a, alpha: M.where(a > 0, a, alpha * a),
    "Elu": lambda M, a, alpha: M.where(a > 0, a, alpha * (M.exp(a) - 1)),
    "Sigmoid": lambda M, a: 0.5 + 0.5 * M.tanh(0.5 * a),  # without exp(-a), whose derivative overflows
    "Softplus": lambda M, a: M.where(a > 0, a + M.log(1 + M.exp(-a)), M.log(1 + M.exp(a))),
    "Clip": lambda M, a, low, high: M.clip(a, low, high),
    "Max": lambda M, a, b: M.maximum(a, b),
    "Min": lambda M, a, b: M.minimum(a, b),
    **{
        name.capitalize(): lambda M, a, name=name: getattr(M, name)(a)
        for name in ("tanh", "exp", "log", "sqrt", "abs", "sin", "cos")
    },
}
KINKED = {"Relu", "LeakyRelu", "Clip", "Max", "Min", "Abs"}


class Affine(NamedTuple):
    """x W + b of the `in` slots from `first` on: W (in, out), b (out,)."""

    first: int
    W: np.ndarray
    b: np.ndarray

    @property
    def size(self) -> int:
        return len(self.b)


class Each(NamedTuple):
    """A formula of single numbers: each operand (size,) is of slots (integers) or of constants."""

    name: str
    operands: tuple[np.ndarray, ...]

    @property
    def size(self) -> int:
        return len(self.operands[0])

    @property
    def traced(self) -> tuple[list[Value], list[str]]:
        """Its value and its tangent along d0, d1, … of the operands a0, a1, …, and the names of those that vary.

        Constants that are all equal are numbers in the formula.
        """
        tape, places = Tape(), range(len(self.operands))
        equal = {k: float(a[0]) for k, a in enumerate(self.operands) if a.dtype.kind == "f" and (a == a[0]).all()}
        a = [equal[k] if k in equal else tape.input(f"a{k}") for k in places]
        vary = [k for k in places if self.operands[k].dtype.kind == "i"]
        y = FORMULAS[self.name](M, *a)
        directions = [tape.input(f"d{k}") for k in vary]
        dy = programs.derivative([y], [a[k] for k in vary], directions) if vary else [0.0]
        return [y, *dy], [f"a{k}" for k in places if k not in equal] + [f"d{k}" for k in vary]

    def tangent(self, s: np.ndarray, ds: np.ndarray) -> np.ndarray:
        """That of its results, of slots s (..., slots) and of theirs."""
        formulas, names = self.traced
        read = {f"d{k}": ds[..., a] for k, a in enumerate(self.operands) if a.dtype.kind == "i"}
        read |= {f"a{k}": s[..., a] if a.dtype.kind == "i" else a for k, a in enumerate(self.operands)}
        with np.errstate(all="ignore"):
            dy = python(formulas, names)(*(read[name] for name in names))[1]
        return np.broadcast_to(dy, (*ds.shape[:-1], self.size))


@dataclass(frozen=True)
class CalledNetwork:
    """A function of `count` numbers by its parts; it gives the slots `outputs`. Equal ones have one name."""

    name: str
    count: int = field(compare=False)
    parts: tuple[Affine | Each, ...] = field(compare=False, repr=False)
    outputs: np.ndarray = field(compare=False, repr=False)

    @property
    def size(self) -> int:
        """How many numbers it gives."""
        return len(self.outputs)

    @property
    def starts(self) -> list[int]:
        """The first slot of each part's result, and last how many slots there are."""
        return np.cumsum([self.count, *(part.size for part in self.parts)]).tolist()

    @property
    def kinks(self) -> set[str]:
        """The formulas in it without a derivative somewhere."""
        return {part.name for part in self.parts if isinstance(part, Each)} & KINKED

    def __call__(self, *x: Value) -> list[Value]:
        """Its values at numbers, arrays or tensors, or, for symbols, as the items of a call on their tape."""
        tape = next((a.tape for a in x if isinstance(a, Symbol)), None)
        if tape is not None:
            tape.networks[self.name] = self
            return tape.call(self.name, x, self.count, self.size)
        return self._outputs(self._memory(_stacked(x)))

    def tangents(self, *x_and_dx: Value) -> list[Value]:
        """Its derivative at x along dx, numbers or NumPy arrays."""
        both = _stacked(x_and_dx)
        s, ds = self._memory(both[..., : self.count]), both[..., self.count :]
        for part in self.parts:
            dy = _product(ds, part) if isinstance(part, Affine) else part.tangent(s, ds)
            ds = np.concatenate([ds, dy], -1)
        return self._outputs(ds)

    def _memory(self, s: Array) -> Array:
        """All slots (..., slots) of inputs (..., count)."""
        library, mathematics = _library(s), array_math.of(s)
        for part in self.parts:
            if isinstance(part, Affine):
                y = _product(s, part) + library.asarray(part.b)
            else:
                a = [s[..., k] if k.dtype.kind == "i" else library.asarray(k) for k in part.operands]
                with np.errstate(all="ignore"):  # of a branch that is not taken
                    y = FORMULAS[part.name](mathematics, *a)
            s = library.concatenate([s, library.broadcast_to(y, (*s.shape[:-1], part.size))], -1)
        return s

    def _outputs(self, s: Array) -> list[Value]:
        return [s[..., k] for k in self.outputs]


def network(count: int, parts: Sequence[Affine | Each], outputs: np.ndarray) -> CalledNetwork:
    """The network of such parts, named after its content."""
    digest = hashlib.sha256(f"{count} {outputs.tolist()}".encode())
    for part in parts:
        of_kind = (part.name, *part.operands) if isinstance(part, Each) else (part.first, part.W, part.b)
        for a in of_kind:
            digest.update(
                f"{a.dtype} {a.shape}".encode() + a.tobytes() if isinstance(a, np.ndarray) else f"{a} ".encode()
            )
    return CalledNetwork(f"network_{digest.hexdigest()[:16]}", count, tuple(parts), outputs)


def _library(s: Array) -> Any:
    """NumPy, or torch for a tensor, which is imported then."""
    return np if isinstance(s, np.ndarray) else importlib.import_module("torch")


def _stacked(x: Sequence[Value]) -> Array:
    """Numbers, arrays or tensors side by side as the last axis."""
    like = max(x, key=np.ndim)
    return array_math.stack(list(x), np.asarray(like) if isinstance(like, Real) else like)


def _product(s: Array, part: Affine) -> Array:
    """x W, without BLAS, whose sums depend on the number of its threads."""
    library = _library(s)
    W = library.asarray(part.W, dtype=s.dtype)
    return library.einsum("...i,io->...o", s[..., part.first : part.first + len(W)], W)
