"""A whole controller as C99: the kernels of its control step, a state, and its test."""

import hashlib
import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np

import npred
from npred import source_lines
from npred.delays import problem_of
from npred.errors import ConfigError, unlisted
from npred.kernels.c_text import comment, constant, literal, single
from npred.kernels.kernel import Kernel, skeleton
from npred.loop import signals
from npred.loop.controller import SNAP, Controller
from npred.plants.base import Plant
from npred.predictors.guarded import bare
from npred.runtimes import c_files, self_test
from npred.runtimes.fused import Fused

NAME = re.compile(r"[a-z][a-z0-9_]{0,30}")
PRECISIONS = {"float": np.float32, "double": np.float64}
LIMITS = {"float": 1e-4, "double": 1e-10}  # of the test in the file, times what it amplifies rounding errors by
WHAT = "export controller"
# of the settings, those that a step reads
NUMBERS = ("dt", "b", "gate", "gamma_dt", "oldest", "after", "uncertain")
FLAGS = ("recalls", "keeps", "gated", "observer_count", "offsets", "watched", "holds", "output_count", "end_count",
         "pulls", "filter_count")  # fmt: skip
ARRAYS = ("bounds", "input_bounds", "p", "ratios", "law", "guard", "reach", "sensing", "rescue", "jump", "safety",
          "anew", "widens")  # fmt: skip


def sources(
    controller: Controller, name: str = "npred", precision: str = "double", model: str = "", tunable: bool = False
) -> tuple[str, str]:
    """The header and the source, with a program in it that tests them (npred.runtimes.self_test).

    A `tunable` controller holds the plant's parameters, gamma dt and the settings of the guard in its C struct, so that
    they can be set. All identifiers begin with `name`.
    Raises ConfigError for a name or precision that is none, and for a controller with a part that runs in Python.
    """
    if not NAME.fullmatch(name):
        raise ConfigError(f"name: expected a short C identifier in lower case, got {name!r}; take npred")
    if precision not in PRECISIONS:
        raise ConfigError(unlisted("precision", precision, PRECISIONS))
    _check(controller)
    kernels = {part: kernel for part, kernel in _parts(controller, precision).items() if kernel}
    variants = {
        "RECALLS": bool(controller.settings.recalls), "KEEPS": controller.keeps_commands,
        "WATCHES": "observe" in kernels, "FILTERS": controller.observer is not None, "TUNABLE": tunable,
        "OFFSETS": bool(controller.settings.offsets), "PROTECTS": controller.safety is not None,
        "REPEATS": precision == "float" and bool(controller.plant.period),
    }  # fmt: skip
    sizes = _sizes(controller, kernels, variants)
    included = {
        "about": "\n".join(f" * {comment(line)}" for line in _about(controller, precision, model)),
        "sizes": "\n".join(f"    {name.upper()}_{size} = {value}," for size, value in sizes.items()),
        "kernels": _kernels(kernels, precision),
        "settings": _settings(controller, kernels, sizes, name.upper(), precision),
        "test": _test(controller, precision),
    }
    files = [c_files.filled(f"controller.{suffix}", name, precision, variants, included) for suffix in "hc"]
    digest = hashlib.sha256("".join(files).encode()).hexdigest()
    words = ", ".join(f"0x{digest[i : i + 8]}u" for i in range(0, 32, 8))
    header, source = (text.replace("0" * 64, digest).replace(", ".join(4 * ["0x00000000u"]), words) for text in files)
    return header, source


def write(
    controller: Controller, folder: Path, name: str = "npred", precision: str = "double", model: str = "",
    mex: bool = False,
) -> tuple[list[Path], str]:  # fmt: skip
    """Write NAME.h, NAME.c and, with `mex`, the gateway NAME_mex.c; the files and their digest. Raises as `sources`."""
    header, source = sources(controller, name, precision, model)
    texts = {f"{name}.h": header, f"{name}.c": source}
    if mex:
        texts[f"{name}_mex.c"] = gateway(controller, name, precision)
    folder.mkdir(parents=True, exist_ok=True)
    for file, text in texts.items():
        (folder / file).write_text(text, encoding="utf-8")
    return [folder / file for file in texts], digest(header)


def gateway(controller: Controller, name: str = "npred", precision: str = "double") -> str:
    """NAME_mex.c, which makes the C that `sources` gives with this name and precision a function of MATLAB."""
    return c_files.filled("gateway.c", name, precision, {"RECALLS": bool(controller.settings.recalls)})


def D_hat_bounds(controller: Controller) -> tuple[float, float]:
    """The smallest and the largest D_hat that the controller in C takes, in seconds; infinity for no limit."""
    low, high = controller.settings.bounds.tolist()
    return low, min(high, controller.longest_D_hat) if controller.settings.recalls else high


def digest(header: str) -> str:
    """The sha256 that a header holds, of both files."""
    return re.findall(r'_DIGEST "([0-9a-f]{64})"', header)[0]


def _check(controller: Controller) -> None:
    """Raise ConfigError for a part that is no kernel."""
    problem_of(controller.plant).needs(WHAT)
    if not controller.predictor.compiled:
        raise ConfigError(
            f"{WHAT}: expected a predictor that is compiled, got {controller.predictor.name}; take a numerical one, or "
            'load the network with runtime = "fused"'
        )
    if controller.parts["update"] and not isinstance(controller.parts["update"], Kernel):
        law = type(controller.adaptation).__name__
        raise ConfigError(f"{WHAT}: expected a delay law that is compiled, {law} runs in Python; take another")


def _parts(controller: Controller, precision: str) -> Mapping[str, Kernel | None]:
    """The kernels of a step by their names in Parts; that of a network in the precision of the file."""
    model = bare(controller.predictor)
    if precision == "double" or not hasattr(model, "operator"):
        return controller.parts
    stride = getattr(model, "stride", None)
    fused = Fused(model.plant, model.operator, model.nx, model.name, stride)  # type: ignore[attr-defined]
    return controller.parts | {"predict": fused.on(model.nx)}


def _sizes(
    controller: Controller, kernels: Mapping[str, Kernel], variants: Mapping[str, bool]
) -> dict[str, int]:  # fmt: skip
    """The sizes of the C structs' arrays, by their names."""
    z, settings, nx = controller.memory, controller.settings, controller.predictor.nx
    sizes = {"N_STATES": controller.plant.n, "M_INPUTS": controller.plant.m, "NX": nx}
    sizes |= {"N_OUTPUTS": len(controller.outputs)}
    sizes |= {"ROWS": len(z.held), "CLOCK": len(z.clock)} if variants["KEEPS"] else {}
    sizes |= {"FILTER": len(z.filter)} if variants["FILTERS"] else {}
    sizes |= {"OBSERVER": len(z.observer)} if variants["WATCHES"] else {}
    sizes |= {"ENDS": len(z.moments)} if variants["PROTECTS"] else {}
    if variants["TUNABLE"]:
        sizes |= {"PARAMETERS": max(settings.p.size, 1), "GUARD": max(settings.guard.size, 1)}
    needed = max(1, *(kernel.work(nx, 1, settings.guard) for kernel in kernels.values()))
    states = controller.plant.n + 3 * controller.plant.m  # of a model that goes on from a sample
    filters = settings.filter_count + 2 * settings.output_count
    return sizes | {"WORK": needed + states + settings.observer_count + filters}


def _kernels(kernels: Mapping[str, Kernel], real: str) -> str:
    """The kernels and the step, as the loop runs them here, with one lane."""
    texts = [text for kernel in kernels.values() for text in kernel.texts]
    loop = [*signals.declared(), *map(skeleton, ("actuator.h", "onward.h", "step.h", "controller.h"))]
    text = "\n".join(dict.fromkeys([skeleton("base.h"), *texts, *loop]))
    return single(text) if real == "float" else text


def _settings(
    controller: Controller, kernels: Mapping[str, Kernel], sizes: Mapping[str, int], prefix: str, real: str
) -> str:
    """The numbers that the controller is set to, and the kernels by their parts, as constants."""
    low, high = D_hat_bounds(controller)
    numbers = {
        "DT": controller.dt, "D_HAT": controller.D_hat, "T0": controller.t, "D_HAT_LOW": low,
        "SNAP": SNAP, "D_HAT_HIGH": high if np.isfinite(high) else np.finfo(PRECISIONS[real]).max,
    }  # fmt: skip
    numbers |= {"PERIOD": controller.plant.period} if controller.plant.period else {}
    settings = controller.settings
    arrays = {name: np.ravel(getattr(settings, name)).astype(float) for name in ARRAYS}
    start = controller.fresh().memory
    arrays |= {"u0": controller.u0, "clock": start.clock[:, 0]} if controller.keeps_commands else {}
    arrays |= {"filter": start.filter[:, 0]} if controller.observer else {}
    values = {name: literal(getattr(settings, name), real) for name in NUMBERS}
    values |= {name: str(int(getattr(settings, name))) for name in FLAGS}
    values |= {name: f"({real} *)the_{name}" for name in ARRAYS}
    shape = f"{sizes['NX']}, 1, {sizes.get('ROWS', 0)}, {controller.plant.n}, {controller.plant.m}"
    lines = [f"#define {prefix}_{name} {float(value)!r}" for name, value in numbers.items()]
    lines += [constant(f"the_{name}", a if a.size else np.zeros(1), real) for name, a in arrays.items()]
    lines += [f"static const Shape the_shape = {{{shape}}};"]
    lines += [
        "static const Settings the_settings = {",
        *(f"    .{name} = {text}," for name, text in values.items()),
        "};",
    ]
    lines += ["static const Parts the_parts = {", *(f"    .{name} = {k.name}," for name, k in kernels.items()), "};"]
    return "\n".join(lines)


def _about(controller: Controller, real: str, model: str) -> list[str]:
    """What the controller is made of, for the head of the file."""
    plant = controller.plant
    law = "frozen" if controller.adaptation is None else f"by {type(controller.adaptation).__name__}"
    return [
        f"The controller of plant {plant.name}, made by npred {npred.__version__}.",
        *([f"Model: {model}."] if model else []),
        f"Predictor {controller.predictor.name} on {controller.predictor.nx} nodes; D_hat {law}.",
        f"A control step each {plant.time_text(controller.dt, '')}; D_hat and t are in this unit too.",
        f"In {real} precision; {source_lines.ranges(plant.inputs, controller.settings.input_bounds)}.",
        f"X: {', '.join(_with_unit(plant, name) for name in plant.states)}.",
        f"U: {', '.join(_with_unit(plant, name) for name in plant.inputs)}.",
    ]


def _with_unit(plant: Plant, name: str) -> str:
    unit = plant.units.get(name, "")
    return f"{name} ({unit})" if unit else name


def _test(controller: Controller, real: str) -> str:
    """Calls of the controller in Python, which the file's program repeats."""
    test, growth = self_test.designed(controller)
    U, D_hat = self_test.answers(controller, test)
    size = np.nanmax(np.abs(U), axis=0)
    arrays = {"X": test.X, "U": U, "D_hat": D_hat, "size": np.append(np.where(size > 0, size, 1.0), D_hat.max() or 1.0)}
    arrays |= {"u": test.u} if test.u.size else {}
    vectors = [constant(f"test_{name}", np.ravel(a), real) for name, a in arrays.items()]
    stamps = {"t": test.t} | ({"taken": test.taken} if controller.settings.recalls else {})
    vectors += [constant(f"test_{name}", a) for name, a in stamps.items()]
    single = real == "float" or getattr(bare(controller.predictor), "precision", None) is np.float32  # of a network
    limit = LIMITS["float" if single else "double"] * max(growth, 1.0)
    counts = f"TEST_CALLS = {len(test.does)}, TEST_ROWS = {len(test.X)}, TEST_U_ROWS = {max(len(test.u), 1)}"
    does = f"static const unsigned char test_does[TEST_CALLS] = {{{', '.join(map(str, test.does))}}};"
    return "\n".join([f"enum {{ {counts} }};", f"#define TEST_LIMIT {limit:.1e}", does, *vectors])
