"""A whole controller as C99: the kernels of its control step, a state, and its test."""

import hashlib
import math
import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np

import npred
from npred.base import source_lines
from npred.base.errors import ConfigError, unlisted
from npred.exports import Exported, WholeController, c_files, filter_test, self_test
from npred.guard.guarded import bare
from npred.kernels.c_text import comment, constant, literal, single
from npred.kernels.kernel import Kernel, skeleton
from npred.loop import signals
from npred.loop.controller import SNAP, Controller
from npred.networks.fused import Fused
from npred.plants import setpoint
from npred.prediction.delays import problem_of

NAME = re.compile(r"[a-z][a-z0-9_]{0,30}")
PRECISIONS = {"float": np.float32, "double": np.float64}
COARSE = 0.02  # of a size, in float: the least h of a safety filter
ON_BOUND = {"float": 1e-5, "double": setpoint.ROUNDING}  # of a state's or an input's size, for the rest of a set-point
LIMITS = {"float": 1e-4, "double": 1e-10}  # limits of the test in the file, times what it amplifies rounding errors by
FAR = 1e30  # an h of a prediction that may overflow in float
WHAT = "export controller"
TAKEN = ("state", "D_hat", "time", "parameters", "one", "u0")  # what other functions of the header are called by


def sources(
    controller: Controller, name: str = "npred", precision: str = "double", model: str = "", tunable: bool = False
) -> tuple[str, str]:
    """The header and the source, with a program in it that tests them (npred.exports.self_test).

    A `tunable` controller holds gamma dt and the settings of the guard in its C struct, so that they can be set. All
    identifiers begin with `name`.
    Raises ConfigError for a name or precision that is none, and for a controller with a part that runs in Python.
    """
    if not NAME.fullmatch(name):
        raise ConfigError(f"name: expected a short C identifier in lower case, got {name!r}; take npred")
    if precision not in PRECISIONS:
        raise ConfigError(unlisted("precision", precision, PRECISIONS))
    problem_of(controller.plant).needs(WHAT)
    if not controller.predictor.compiled:
        what = f"expected a predictor that is compiled, got {controller.predictor.name}"
        raise ConfigError(f'{WHAT}: {what}; take a numerical one, or load the network with runtime = "fused"')
    if controller.parts["update"] and not isinstance(controller.parts["update"], Kernel):
        law = type(controller.adaptation).__name__
        raise ConfigError(f"{WHAT}: expected a delay law that is compiled, {law} runs in Python; take another")
    parts, network = controller.parts, bare(controller.predictor)
    if precision == "float" and hasattr(network, "operator"):  # that of a network in the precision of the file
        stride = getattr(network, "stride", None)
        fused = Fused(network.plant, network.operator, network.nx, network.name, stride)  # type: ignore[attr-defined]
        parts = parts | {"predict": fused.on(network.nx)}
    kernels = {part: kernel for part, kernel in parts.items() if kernel}
    free = settable(controller)
    settle = [controller.plant.settle] if free and controller.plant.declares_setpoint else []
    variants = {
        "READS_COMMANDS": bool(controller.settings.reads_commands),
        "KEEPS_COMMANDS": controller.keeps_commands,
        "WATCHES": "observe" in kernels,
        "FILTERS": controller.observer is not None,
        "TUNABLE": tunable,
        "SETS": bool(free),
        "SETTLES": bool(settle),
        "OFFSETS": bool(controller.settings.offsets),
        "PROTECTS": controller.safety is not None,
        "REPEATS": precision == "float" and bool(controller.plant.period),
    }
    sizes = _sizes(controller, kernels, variants)
    loop = [*signals.declared(), *map(skeleton, ("actuator.h", "onward.h", "step.h", "gate.h", "controller.h"))]
    texts = [text for kernel in (*kernels.values(), *settle) for text in kernel.texts]
    text = "\n".join(dict.fromkeys([skeleton("base.h"), *texts, *loop]))  # as the loop runs them here, with one lane
    lines = [*_about(controller, name, precision, model), _bytes(sizes, variants, precision)]
    if controller.safety:
        most = controller.safety.operations(controller.plant)
        lines += [f"A step of its safety filter takes {most / 1e6:.2g} million floating-point operations at most."]
    included = {
        "period": f"#define {name.upper()}_DT {controller.dt!r}",
        "about": "\n".join(f" * {comment(line)}" for line in lines),
        "sizes": "\n".join(f"    {name.upper()}_{size} = {value}," for size, value in sizes.items()),
        "kernels": single(text) if precision == "float" else text,
        "settings": _settings(controller, kernels, sizes, name.upper(), precision),
        "setters": "".join(f"{_setter(name, one, precision)};\n" for one in free),
        "set": "\n".join(_setter(name, one, precision, k) for k, one in enumerate(free)),
        "test": _test(controller, name, precision),
    }
    files = [c_files.filled(f"controller.{suffix}", name, precision, variants, included) for suffix in "hc"]
    digest = hashlib.sha256("".join(files).encode()).hexdigest()
    words = ", ".join(f"0x{digest[i : i + 8]}u" for i in range(0, 32, 8))
    header, source = (text.replace("0" * 64, digest).replace(", ".join(4 * ["0x00000000u"]), words) for text in files)
    return header, source


def export(of: WholeController, path: Path, *, name: str, precision: str) -> Exported:
    """Write NAME.h and NAME.c to a folder. Raises as `sources`, and ConfigError for a path that is a C file's."""
    if path.suffix in (".c", ".h"):
        raise ConfigError(f"path: expected a folder, got {str(path)!r}; give the name of its files as name")
    header, source = sources(of.controller, name, precision, of.about)
    files = [path / f"{name}.h", path / f"{name}.c"]
    path.mkdir(exist_ok=True)
    for file, text in zip(files, (header, source), strict=True):
        file.write_text(text, encoding="utf-8")
    return Exported(files, {"digest": digest(header)}, f"{of.controller!r} in {precision} precision")


def D_hat_bounds(controller: Controller) -> tuple[float, float]:
    """The smallest and the largest D_hat that the controller in C takes; infinity for no limit."""
    low, high = controller.settings.bounds.tolist()
    return low, min(high, controller.memory.longest_D_hat) if controller.settings.reads_commands else high


def settable(controller: Controller) -> dict[str, float]:
    """The parameters that can be set while it runs, with their values now."""
    return {name: value for name, value in controller.parameters.items() if name not in controller.fixed}


def _setter(name: str, parameter: str, real: str, number: int | None = None) -> str:
    """The C function that sets one parameter, the one of that number, or its head alone."""
    letters = re.sub(r"[^A-Za-z0-9_]", lambda letter: f"u{ord(letter[0]):04x}", parameter)
    letters += "_" * (letters in TAKEN)
    head = f"int {name}_set_{letters}({name}_controller *self, {real} value)"
    return head if number is None else f"{head}\n{{\n    return {name}_set_one(self, {number}, value);\n}}\n"


def digest(header: str) -> str:
    """The sha256 that a header holds, of both files."""
    return re.findall(r'_DIGEST "([0-9a-f]{64})"', header)[0]


def _sizes(controller: Controller, kernels: Mapping[str, Kernel], variants: Mapping[str, bool]) -> dict[str, int]:
    """The sizes of the C structs' arrays, by their names."""
    z, settings, nx = controller.memory.signals, controller.settings, controller.predictor.nx
    sizes = {"N_STATES": controller.plant.n, "M_INPUTS": controller.plant.m, "NX": nx}
    sizes |= {"N_OUTPUTS": len(controller.outputs)}
    sizes |= {"ROWS": len(z.held), "CLOCK": len(z.clock)} if variants["KEEPS_COMMANDS"] else {}
    sizes |= {"FILTER": len(z.filter)} if variants["FILTERS"] else {}
    sizes |= {"OBSERVER": len(z.observer)} if variants["WATCHES"] else {}
    sizes |= {"ENDS": len(z.moments), "PLAN": len(z.plan)} if variants["PROTECTS"] else {}
    if variants["TUNABLE"]:
        sizes |= {"GUARD": max(settings.guard.size, 1)}
    sizes |= {"PARAMETERS": len(settable(controller)), "NUMBERS": settings.p.size} if variants["SETS"] else {}
    needed = max(1, *(kernel.work(nx, 1, settings.guard) for kernel in kernels.values()))
    states = 2 * controller.plant.n + 3 * controller.plant.m  # scratch of a model that goes on from a sample
    filters = settings.filter_count + 3 * settings.output_count + 1
    return sizes | {"WORK": needed + states + settings.observer_count + filters}


def _bytes(sizes: Mapping[str, int], variants: Mapping[str, bool], real: str) -> str:
    """What the C structs take in memory, where an int64_t is aligned to 8 bytes."""
    _, *structs = c_files.filled("controller.h", "npred", "npred_real", variants, {}).split("typedef struct {")
    taken = [40]  # the digest, the checksum, steps and t0
    for struct in structs[:2]:
        arrays = ", ".join(re.findall(r"^ +npred_real (.+?);", struct.split("\n}")[0], re.MULTILINE)).split(", ")
        words = [re.findall(r"\w+", array)[1:] for array in arrays]
        counts = (math.prod(sizes.get(word.removeprefix("NPRED_")) or int(word) for word in one) for one in words)
        taken.append(-(-(taken[-1] + np.dtype(PRECISIONS[real]).itemsize * sum(counts)) // 8) * 8)
    return f"It takes {taken[2]} bytes of memory, of which its state is {taken[1]}."


def _settings(
    controller: Controller, kernels: Mapping[str, Kernel], sizes: Mapping[str, int], prefix: str, real: str
) -> str:
    """The numbers that the controller is set to, and the kernels by their parts, as constants."""
    low, high = D_hat_bounds(controller)
    numbers = {"D_HAT": controller.D_hat, "T0": controller.t, "D_HAT_LOW": low, "SNAP": SNAP}
    first, last = controller.adaptation.ends(controller.dt) if controller.adaptation else (-np.inf, np.inf)
    first, last = (first, last) if first < last else (-np.inf, np.inf)
    largest = np.finfo(PRECISIONS[real]).max
    numbers |= {"D_HAT_FIRST": max(first, -largest), "D_HAT_LAST": min(last, largest)}
    numbers |= {"D_HAT_HIGH": high if np.isfinite(high) else largest}
    numbers |= {"PERIOD": controller.plant.period} if controller.plant.period else {}
    settings = controller.settings
    controls = {s.name: (s, getattr(settings, s.name)) for s in signals.CONTROLS}
    arrays = {name: np.ravel(a).astype(float) for name, (s, a) in controls.items() if s.axes is not None}
    values = {name: f"({real} *)the_{name}" for name in arrays}
    for name, (s, value) in controls.items():
        if s.axes is None:
            values[name] = literal(value, real) if s.kind == "float64" else str(int(value))
    start = controller.fresh().memory.signals
    if controller.keeps_commands:
        limits = np.ravel(controller.loop.input_bounds)
        arrays |= {"u0": controller.u0, "u0_bounds": limits, "clock": start.clock[:, 0]}
    arrays |= {"filter": start.filter[:, 0]} if controller.observer else {}
    shape = f"{sizes['NX']}, 1, {sizes.get('ROWS', 0)}, {controller.plant.n}, {controller.plant.m}"
    lines = [f"#define {prefix}_{name} {float(value)!r}" for name, value in numbers.items()]
    lines += [constant(f"the_{name}", a if a.size else np.zeros(1), real) for name, a in arrays.items()]
    lines += [f"static const Shape the_shape = {{{shape}}};"]
    if free := settable(controller):
        places = ", ".join(str(controller.plant.p_names.index(name)) for name in free)
        lines += [f"static const int the_places[{len(free)}] = {{{places}}};"]
    if free and controller.plant.declares_setpoint:
        limits = setpoint.bounds(controller.plant, settings.input_bounds, ON_BOUND[real])
        lines += [
            constant("the_units", controller.plant.scales, real),
            constant("the_rest_bounds", limits.ravel(), real),
        ]
        lines += [f"#define the_settle {controller.plant.settle.name}"]
    pointers = {name: kernel.name for name, kernel in kernels.items()}
    for kind, members in (("Settings", values), ("Parts", pointers)):
        entries = (f"    .{name} = {text}," for name, text in members.items())
        lines += [f"static const {kind} the_{kind.lower()} = {{", *entries, "};"]
    return "\n".join(lines)


def _about(controller: Controller, name: str, real: str, model: str) -> list[str]:
    """The lines about this controller at the top of both files."""
    plant = controller.plant
    law = "is constant" if controller.adaptation is None else f"moves by {type(controller.adaptation).__name__}"
    units = {name: f"{name} ({unit})" for name, unit in plant.units.items() if unit}
    signals_of = {"X, a sample": controller.outputs, "U": plant.inputs}
    signals_of |= {"States of P": plant.states} if controller.observer else {}
    u0 = source_lines.values(plant.inputs, controller.u0) if controller.keeps_commands else ""
    return [
        f"Controller for plant {plant.name}, exported by npred {npred.__version__}.",
        *([f"Model: {model}."] if model else []),
        f"The predictor is {controller.predictor.name} on {controller.predictor.nx} nodes. D_hat {law}.",
        f"The control step is {plant.time_text(controller.dt, '')}; D_hat and t have the same unit.",
        f"Numbers are {real}; {source_lines.ranges(plant.inputs, controller.settings.input_bounds)}.",
        *([f"Before the first step the actuator had {u0}, or what {name}_set_u0 says."] if u0 else []),
        *(f"{what}: {', '.join(units.get(name, name) for name in names)}." for what, names in signals_of.items()),
    ]


def _single(controller: Controller, real: str) -> bool:
    """Whether the export, or a network in it, computes in single precision."""
    return real == "float" or getattr(bare(controller.predictor), "precision", None) is np.float32


def _test(controller: Controller, name: str, real: str) -> str:
    """Calls of the controller in Python, which the file's program repeats."""
    test, growth = self_test.designed(controller)
    U, D_hat = self_test.answers(controller, test)
    size = np.nanmax(np.abs(U), axis=0)
    arrays = {"X": test.X, "U": U, "D_hat": D_hat, "size": np.append(np.where(size > 0, size, 1.0), D_hat.max() or 1.0)}
    arrays |= {"u": test.u} if test.u.size else {}
    vectors = [constant(f"test_{key}", np.ravel(a), real) for key, a in arrays.items()]
    stamps = {"t": test.t} | ({"taken": test.taken} if controller.settings.reads_commands else {})
    vectors += [constant(f"test_{key}", a) for key, a in stamps.items()]
    cases = ""
    if controller.safety:
        h, filtered, grown = self_test.kept(controller, test)
        lost = (grown > self_test.GROWTH) | (np.abs(h) > FAR)
        growth = grown[~lost].max(initial=0.0)
        vectors += [constant("test_filtered", np.where(lost, 2.0, filtered), real), constant("test_kept", h, real)]
        vectors += [f"#define TEST_COARSE {COARSE}", f"#define TEST_H {float(np.nanmedian(np.abs(h))) or 1.0!r}"]
        of_filter = filter_test.cases(controller, PRECISIONS[real])
        cases = f", TEST_CASES = {len(of_filter.arguments)}, TEST_ARGUMENTS = {of_filter.arguments.shape[1]}"
        vectors += [
            constant(f"test_{key}", np.ravel(a), real) for key, a in of_filter._asdict().items() if a.dtype == float
        ]
        vectors += [constant("test_rounds", np.ravel(of_filter.rounds), "int")]
    limit = LIMITS["float" if _single(controller, real) else "double"] * max(growth, 1.0)
    counts = f"TEST_CALLS = {len(test.does)}, TEST_ROWS = {len(test.X)}, TEST_U_ROWS = {max(len(test.u), 1)}{cases}"
    does = f"static const unsigned char test_does[TEST_CALLS] = {{{', '.join(map(str, test.does))}}};"
    sets = []
    if values := self_test.moved(controller):
        vectors.append(constant("test_p", np.array([*values.values()]), real))
        setters = (_setter(name, one, real).split("(")[0].split()[1] for one in values)
        lines = [f"    {setter}(c, test_p[{k}]);" for k, setter in enumerate(setters)]
        sets = [f"static void test_set({name}_controller *c)", "{", *lines, "}"]
    return "\n".join([f"enum {{ {counts} }};", f"#define TEST_LIMIT {limit:.1e}", does, *vectors, *sets])
