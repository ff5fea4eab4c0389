"""An operator on a fixed grid as a short program of matrix products, which npred.networks.fused prints as C.

All that does not depend on the sample is folded into constants here: the grid's transforms, the trunk, the weights.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import ClassVar

import numpy as np

Layers = Sequence[Mapping[str, np.ndarray]]  # the weight (out, in) and the bias (out,) of each layer


Shapes = dict[str, tuple[int, ...]]  # the shape of each array in a file of weights


def linear_shapes(name: str, fan_in: int, fan_out: int, bias: bool = True) -> Shapes:
    return {f"{name}.weight": (fan_out, fan_in)} | ({f"{name}.bias": (fan_out,)} if bias else {})


def mlp_shapes(name: str, sizes: list[int], bias: bool = True) -> Shapes:
    """Linear layers of these sizes, an activation between them; `bias` is that of the last."""
    shapes, last = {}, len(sizes) - 2
    for k, (fan_in, fan_out) in enumerate(pairwise(sizes)):
        shapes |= linear_shapes(f"{name}.{2 * k}", fan_in, fan_out, bias or k < last)
    return shapes


def silu(a: np.ndarray) -> np.ndarray:
    """a / (1 + exp(-a)), the networks' activation."""
    with np.errstate(over="ignore"):  # far below zero it is zero
        return a / (1 + np.exp(-a))


def product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """a @ b of (..., i, j) and (..., j, k), without BLAS, whose sums depend on the number of its threads."""
    return np.einsum("...ij,...jk->...ik", a, b)


def mlp(layers: Layers, a: np.ndarray) -> np.ndarray:
    """Linear layers with SiLU between them, of rows a (..., in)."""
    for k, layer in enumerate(layers):
        a = product(silu(a) if k else a, layer["weight"].T) + layer.get("bias", 0.0)
    return a


@dataclass(frozen=True)
class Matrix:
    """A view of a named flat array: element (i, k) is name[offset + e turn + i row + k column].

    e counts the repetitions of a product. With `layer`, name is a stack of constants of that size, one per layer. With
    `panel` the columns lie in panels of so many, one after the other: see Program.weights.
    """

    name: str
    row: int
    column: int = 1
    offset: int = 0
    turn: int = 0
    layer: int = 0
    panel: int = 0


TILES = {1: 8, 2: 6, 3: 4}  # vectors of the widest tile of a product with one row, two, or more: kernels/c/network.h
TILE_BYTES = 32  # size of a vector; on processors with shorter ones it is several
View = Callable[["Matrix | None"], str]  # the C of a matrix: see npred.networks.fused


@dataclass(frozen=True)
class Product:
    """out (M, N) = start + a (M, K) b (K, N), with start = `bias` (its row 0 for each row if row = 0), out, or zero."""

    out: Matrix
    a: Matrix
    b: Matrix
    shape: tuple[int, int, int]  # M, K, N
    bias: Matrix | None = None
    adds: bool = False
    repeats: int = 1

    def lines(self, view: View) -> list[str]:
        """Its C: a call with literal sizes and strides, as of the other operations."""
        matrices = ", ".join(map(view, (self.out, self.a, self.b, self.bias)))
        sizes = (*self.shape, self.b.panel or self.shape[2])
        call = f"product({', '.join(map(str, sizes))}, {matrices}, {int(self.adds)});"
        return [call] if self.repeats == 1 else [f"for (int e = 0; e < {self.repeats}; e++) {{", f"    {call}", "}"]


@dataclass(frozen=True)
class Dots:
    """out (M, N) = bias + a (M, K) times the transpose of b (N, K), for few columns N."""

    out: Matrix
    a: Matrix
    b: Matrix
    shape: tuple[int, int, int]  # M, K, N
    bias: Matrix | None = None

    def lines(self, view: View) -> list[str]:
        matrices = ", ".join(map(view, (self.out, self.a, self.b, self.bias)))
        return [f"dots({', '.join(map(str, self.shape))}, {matrices});"]


@dataclass(frozen=True)
class Silu:
    """out[:count] = silu(a[:count])."""

    out: str
    a: str
    count: int
    function: ClassVar[str] = "silu"

    def lines(self, view: View) -> list[str]:
        return [f"{self.function}({self.count}, q->{self.a}, q->{self.out});"]


@dataclass(frozen=True)
class SiluPair(Silu):
    """Of rows (difference, rest) of `count` numbers each: silu(rest + difference) - silu(rest), and silu(rest)."""

    function: ClassVar[str] = "silu_pair"


@dataclass(frozen=True)
class SiluParts(Silu):
    """Of the even and the odd parts of `count` numbers each: the sums and the differences of silu(even +- odd)."""

    function: ClassVar[str] = "silu_parts"


@dataclass(frozen=True)
class Recombine:
    """y (2 modes, width), all Re, then all Im, = R v, of `pairs` (2 modes, 2 width): Re v, Im v times (Re R, Im R)."""

    y: str
    pairs: str
    modes: int
    width: int

    def lines(self, view: View) -> list[str]:
        return [f"recombine({self.modes}, {self.width}, q->{self.pairs}, q->{self.y});"]


@dataclass(frozen=True)
class Mirror:
    """out (rows, nx) of its even and odd parts about the middle, given on the first half: even + odd, even - odd."""

    out: Matrix
    even: Matrix
    odd: Matrix
    rows: int
    nx: int

    def lines(self, view: View) -> list[str]:
        return [f"mirror({self.rows}, {self.nx}, {', '.join(map(view, (self.even, self.odd, self.out)))});"]


@dataclass(frozen=True)
class Parts:
    """The sums and the differences (2 half, width) of the rows of `a` (nx, width) and those from the end on."""

    out: str
    a: str
    nx: int
    width: int

    def lines(self, view: View) -> list[str]:
        return [f"parts({self.nx}, {self.width}, q->{self.a}, q->{self.out});"]


@dataclass(frozen=True)
class Halves:
    """The even and the odd parts (m, nodes) of `a` (nx, m) about the middle, on the first half, and zeros behind."""

    even: Matrix
    odd: Matrix
    a: str
    nx: int
    m: int

    def lines(self, view: View) -> list[str]:
        return [f"halves({self.m}, {self.nx}, {self.even.row}, q->{self.a}, q->{self.even.name}, q->{self.odd.name});"]


@dataclass(frozen=True)
class Repeat:
    """The same operations for o = 0 … count - 1: the layers of a network, their constants stacked."""

    count: int
    operations: tuple["Operation", ...]

    def lines(self, view: View) -> list[str]:
        inner = [f"    {line}" for operation in self.operations for line in operation.lines(view)]
        return [f"for (int o = 0; o < {self.count}; o++) {{", *inner, "}"]


Operation = Product | Dots | Silu | Recombine | Mirror | Parts | Halves | Repeat


@dataclass(frozen=True)
class Series:
    """N_rest (n, nodes), N at rest for D_hat in [low, high], by a product with T, Chebyshev's polynomials of D_hat."""

    low: float
    high: float
    terms: int
    product: Product


@dataclass
class Program:
    """The operations from the inputs that a runtime scales first to N (n, nodes), and P = base + gain (N - N_rest).

    N is given on every `stride`-th of the nx nodes, with cubics between.

    z (rows, states + clock + 1): X, scaled and less its value at rest, cosine and sine of the phase in `period` where
    the network sees it, and scaled D_hat. v (nx, m): u likewise; r (m, nx): the running mean of v. At rest X and u give
    zeros, to the bit. With rows = 2 the first row of z is the difference of the sample from the plant at rest, without
    phase and D_hat, and the second the plant at rest, these alone: the network carries both, and N is
    N(sample) - N(rest) with a relative error of rounding. With a series N is N(sample), and the series is N(rest); with
    `twice` both are evaluated one after the other.
    X_bend, X_zero, X_gain, u_zero, u_gain, D_hat_zero and D_hat_gain scale the inputs, in double precision.
    """

    n: int
    m: int
    nx: int
    rows: int = 1
    stride: int = 1
    period: float | None = None  # period of the plant's time, where the network sees it
    twice: bool = False
    precision: type[np.floating] = np.float32  # type of the constants and buffers
    series: Series | None = None
    constants: dict[str, np.ndarray] = field(default_factory=dict)
    buffers: dict[str, int] = field(default_factory=dict)
    operations: list[Operation] = field(default_factory=list)
    z_zero: np.ndarray = field(default_factory=lambda: np.zeros(0))  # (n,), what the network sees where z is zero
    v_zero: np.ndarray = field(default_factory=lambda: np.zeros(0))  # (m,), and where v is

    def __post_init__(self) -> None:
        n, m, nx = self.n, self.m, self.nx
        self.buffers |= {"z": self.rows * self.columns, "v": nx * m, "r": m * nx, "N": n * self.nodes}

    @property
    def seen(self) -> int:
        """The columns of z before D_hat: X, and the phase where the network sees it."""
        return self.n + (2 if self.period else 0)

    @property
    def columns(self) -> int:
        return self.seen + 1

    @property
    def rounding(self) -> float:
        """The relative rounding error of the precision."""
        return float(np.finfo(self.precision).eps)

    @property
    def nodes(self) -> int:
        """The number of nodes that the network is evaluated on: every stride-th."""
        return (self.nx - 1) // self.stride + 1

    def constant(self, name: str, values: np.ndarray) -> Matrix:
        """A constant (rows, columns), or a row for all rows, under a name."""
        self.constants[name] = np.ascontiguousarray(values, dtype=self.precision).reshape(-1)
        return Matrix(name, values.shape[-1] if values.ndim > 1 else 0)

    def buffer(self, name: str, rows: int, columns: int) -> Matrix:
        self.buffers[name] = rows * columns
        return Matrix(name, columns)

    def weights(self, name: str, values: np.ndarray, rows: int) -> Matrix:
        """A constant b (K, N) of products with so many rows, its columns in panels as wide as the widest tile."""
        panel = TILES.get(rows, TILES[3]) * TILE_BYTES // np.dtype(self.precision).itemsize
        panels = [values[:, first : first + panel].ravel() for first in range(0, values.shape[1], panel)]
        self.constant(name, np.concatenate(panels))
        return Matrix(name, values.shape[1], panel=panel)

    def stack(self, name: str, values: Sequence[np.ndarray], rows: int = 0) -> Matrix:
        """Constants of equal shape, one per layer; with `rows` as `weights` has them."""
        layers = []
        for layer in values:
            first = self.weights(name, layer, rows) if rows else self.constant(name, layer)
            layers.append(self.constants[name])
        self.constants[name] = np.concatenate(layers)
        return replace(first, layer=values[0].size)

    def rounded(self, columns: int) -> int:
        """So many columns or a few more, whole vectors."""
        lane = 2 * TILE_BYTES // np.dtype(self.precision).itemsize
        return -(-columns // lane) * lane

    def scale(self, name: str, values: np.ndarray) -> None:
        """A constant of the inputs' scaling, in double precision."""
        self.constants[name] = np.array(values, dtype=np.float64).reshape(-1)
