"""A kernel: C text with one entry, compiled when it is first called or pointed to."""

import ctypes
import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np

from npred.kernels import compiler

FOLDER = Path(__file__).parent / "c"
# Arguments that are numbers; others are arrays
NUMBERS = {"t": "double", "dt": "double", "b": "double", "gate": "double", "k": "INDEX", "origin": "INDEX"}
PREPARED = ctypes.CFUNCTYPE(None, ctypes.c_void_p)
KINDS = {"double": ctypes.c_double, "INDEX": ctypes.c_int64, None: ctypes.c_void_p}
AXES = {  # axes of the arrays that tell the sizes of a call, before the lanes; the last array counts
    **dict.fromkeys(
        ("D_hat", "phi", "N", "error", "fallback", "kept", "filtered", "unkept", "promised", "withdrawn"), ()
    ),
    **dict.fromkeys(("X", "X_hat", "Y"), ("n",)),
    **dict.fromkeys(("U", "U0", "U1", "share", "D", "D_seen", "speed", "low", "high"), ("m",)),
    **dict.fromkeys(("u", "u_nodes"), ("nx", "m")),
    **dict.fromkeys(("P_hat", "P"), ("nx", "n")),
    **dict.fromkeys(("held", "total"), ("rows", "m")),
    **dict.fromkeys(("spans", "moments"), ("rows",)),
    "plan": ("plan",),
}
Work = Callable[[int, int, Any], int]  # doubles that a call needs, by nodes, lanes and the settings of a guard


class Shape(ctypes.Structure):
    """The sizes of a call: nodes, lanes, rows of the history, states, inputs."""

    _fields_ = tuple((name, ctypes.c_int) for name in ("nx", "lanes", "rows", "n", "m"))


@cache
def skeleton(name: str) -> str:
    """The text of a file of npred/kernels/c."""
    return (FOLDER / name).read_text(encoding="utf-8")


def names(arguments: str) -> list[str]:
    """The names of arguments, of which & marks those that are written."""
    return arguments.replace("&", "").split(", ")


def prototype(name: str, arguments: str) -> str:
    """The C declaration of a function of such arguments, of the shape before them and scratch memory behind them."""
    kinds = [f"{NUMBERS[a]} {a}" if a in NUMBERS else f"const double *{a}" for a in arguments.split(", ")]
    kinds = [kind.replace("const double *&", "double *") for kind in kinds]
    return f"void {name}(Shape d, {', '.join(kinds)}, double *work)"


@cache
def foreign_type(arguments: str) -> Any:
    """The same for ctypes."""
    kinds = [KINDS[NUMBERS.get(name)] for name in names(arguments)]
    return ctypes.CFUNCTYPE(None, Shape, *kinds, ctypes.c_void_p)


@dataclass(frozen=True)
class Kernel:
    """A C function of the arrays `arguments`, as npred.prediction.delays.problem names them; its text calls `before`
    and `parts`.

    Arrays have their lanes innermost. `exact` ones round as compiler.EXACT has it, `loose` ones never do: a network's
    sums depend on the width of the processor's vectors anyway.
    """

    name: str
    arguments: str
    text: str
    before: tuple[str, ...] = ()
    parts: tuple["Kernel", ...] = ()
    sizes: tuple[int, int] = (0, 0)  # states and inputs
    work: Work = lambda nx, lanes, settings: 0
    exact: bool = False
    loose: bool = False

    @cached_property
    def exactly(self) -> "Kernel":
        """The same, exact unless it is loose."""
        return self if self.loose else replace(self, exact=True)

    @property
    def texts(self) -> list[str]:
        """Its C, after that of the parts."""
        return [*self.before, *(text for part in self.parts for text in part.texts), self.text]

    @property
    def unit(self) -> str:
        """A file of C with all that it needs, each text once."""
        passed = ", ".join(["d", *names(self.arguments), "work"])
        entry = f"{prototype('entry', self.arguments)}\n{{\n    {self.name}({passed});\n}}\n"
        kinds = [f"*({NUMBERS[a]} *)" if a in NUMBERS else "" for a in names(self.arguments)]
        kept = ", ".join(f"{kind}q[{k}]" for k, kind in enumerate(["*(Shape *)", *kinds, ""]))
        prepared = f"void prepared(void *const *q)\n{{\n    {self.name}({kept});\n}}\n"
        return "\n".join(dict.fromkeys([skeleton("base.h"), *self.texts, entry, prepared]))

    @cached_property
    def function(self) -> Any:
        return foreign_type(self.arguments)(("entry", compiler.library(self.unit, self.exact)))

    @cached_property
    def prepared(self) -> Any:
        """The same of the addresses of its arguments: ctypes takes a third of the time for one argument."""
        return PREPARED(("prepared", compiler.library(self.unit, self.exact)))

    @property
    def is_compiled(self) -> bool:
        """True if its function is there already."""
        return "function" in vars(self)

    @cached_property
    def address(self) -> int:
        """The address of the compiled function."""
        return ctypes.cast(self.function, ctypes.c_void_p).value or 0

    def __call__(self, *values: Any, scratch: Any = ()) -> None:
        """Run it on C-contiguous arrays of float64, and numbers; `scratch` is in its scratch memory at first."""
        self.bound(*values, scratch=scratch)()

    def bound(self, *values: Any, scratch: Any = ()) -> Callable[[], None]:
        """The call on these arrays: each time it reads their values of then, and takes no longer than in a loop.

        A number may be a ctypes object, which is read then too.
        """
        sizes: dict[str, int] = dict(zip(("n", "m"), self.sizes, strict=True))
        for position, axes in self._sized:
            sizes |= zip(axes, values[position].shape, strict=True)
        shape = Shape(**sizes)
        settings = values[self._guard] if self._guard is not None else None
        work = np.empty(self.work(shape.nx, shape.lanes, settings))
        work[: len(scratch)] = scratch
        kinds = [KINDS[NUMBERS.get(name)] for name in names(self.arguments)]
        passed = [  # a number gets an address too
            value if isinstance(value, np.ndarray | ctypes._SimpleCData) else kind(value)
            for kind, value in zip(kinds, values, strict=True)
        ]
        held = [shape, *passed, work]
        addresses = (ctypes.c_void_p * len(held))(*map(address, held))
        call = partial(self.prepared, ctypes.addressof(addresses))
        call.held = addresses, held  # type: ignore[attr-defined]  # which keeps the memory
        return call

    @cached_property
    def _sized(self) -> list[tuple[int, tuple[str, ...]]]:
        """The places of the arguments that tell the sizes of a call, and their axes."""
        places = names(self.arguments)
        return [(places.index(name), (*axes, "lanes")) for name, axes in AXES.items() if name in places]

    @cached_property
    def _guard(self) -> int | None:
        """The place of the settings of a guard."""
        return next((place for place, name in enumerate(names(self.arguments)) if name == "guard"), None)


def bound(run: Callable[..., None], *values: Any) -> Callable[[], None]:
    """The call of a kernel, or of a function in its place, on these arrays."""
    return run.bound(*values) if isinstance(run, Kernel) else partial(run, *values)


def address(value: Any) -> int:
    """Where an array, or an object of ctypes, begins."""
    if not isinstance(value, np.ndarray):
        return ctypes.addressof(value)
    try:
        return ctypes.addressof(ctypes.c_char.from_buffer(value))  # type: ignore[arg-type]  # a fifth of the time
    except (TypeError, ValueError):  # one that cannot be written, or is empty
        return value.__array_interface__["data"][0]


def made(
    name: str, arguments: str, body: str, functions: Mapping[str, str], sizes: Mapping[str, Any] = {},
    parts: Mapping[str, Kernel] = {}, before: Sequence[str] = (), **rest: Any,
) -> Kernel:  # fmt: skip
    """The kernel of a skeleton's text, its macros being functions (their C with {name}), numbers and other kernels.

    All names that it defines end with a digest of the text, so that kernels can stand side by side.
    """
    macros = {key: str(value) for key, value in sizes.items()} | {key: part.name for key, part in parts.items()}
    digest = hashlib.sha256(repr((body, macros, functions, *before)).encode()).hexdigest()[:8]
    named = {key: f"{name}_{key.lower()}_{digest}" for key in functions}
    texts = [text.replace("{name}", named[key]) for key, text in functions.items()]
    macros |= {"KERNEL": f"{name}_{digest}"} | named
    defines = [f"#define {key} {value}" for key, value in macros.items()]
    ends = [f"#undef {key}" for key in macros]
    text = "\n".join([*texts, *defines, body, *ends]) + "\n"
    counts = sizes.get("N", 0), sizes.get("M", 0)
    return Kernel(f"{name}_{digest}", arguments, text, tuple(before), tuple(parts.values()), counts, **rest)


class Failure:
    """Whether a part in Python of a loop in C has failed, for that loop to see, and its error."""

    def __init__(self) -> None:
        self.flag = ctypes.c_int(0)
        self.error: BaseException | None = None

    def raised(self) -> None:
        """Raise that error, once."""
        error, self.error, self.flag.value = self.error, None, 0
        if error is not None:
            raise error


def callback(function: Callable[..., Any], arguments: str, fixed: Mapping[str, np.ndarray], failure: Failure) -> Any:
    """The pointer to a function of these arguments, which gets views of the loop's memory.

    `fixed` are arrays whose shape the sizes of a call do not tell.
    """
    argument_names = names(arguments)
    views: dict[tuple[int, tuple[int, ...]], np.ndarray] = {}

    def viewed(name: str, value: Any, shape: Shape) -> Any:
        if name in NUMBERS or name in fixed:
            return fixed.get(name, value)
        sizes = (*(getattr(shape, axis) for axis in AXES[name]), shape.lanes)
        if (value, sizes) not in views:
            numbers = (ctypes.c_double * int(np.prod(sizes))).from_address(value)
            views[value, sizes] = np.ctypeslib.as_array(numbers).reshape(sizes)
        return views[value, sizes]

    def call(shape: Shape, *values: Any) -> None:
        if failure.error is None:
            try:
                with np.errstate(all="ignore"):  # a loop that overflows is NaN, and no cause for a warning
                    passed = zip(argument_names, values[:-1], strict=True)
                    function(*(viewed(name, value, shape) for name, value in passed))
            except BaseException as error:  # it cannot pass through C
                failure.error = error
                failure.flag.value = 1

    return foreign_type(arguments)(call)
