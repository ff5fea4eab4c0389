"""A network that a law calls, in C: its numbers are constants, its matrices and formulas loops on slots of memory."""

import numpy as np

from npred.formulas import programs
from npred.formulas.network import Affine, CalledNetwork, Each
from npred.kernels.c_text import constant
from npred.kernels.kernel import skeleton
from npred.kernels.statements import CALLED, LOOP, TEXTS, statement


class _Constants:
    """The constants of a network, equal ones once."""

    def __init__(self, network: CalledNetwork) -> None:
        self.prefix, self.texts = network.name, dict[str, str]()

    def name(self, values: np.ndarray) -> str:
        text = constant("{name}", values.ravel(), "int" if values.dtype.kind == "i" else "double")
        return self.texts.setdefault(text, f"{self.prefix}_{len(self.texts)}")

    def item(self, values: np.ndarray) -> str:
        """Number i of constants or slots; slots that are the same, or next to each other, need no constant."""
        first, is_slots = values[0], values.dtype.kind == "i"
        if is_slots and (values == first).all():
            return str(first)
        return f"{first} + i" if is_slots and (np.diff(values) == 1).all() else f"{self.name(values)}[i]"


def texts(network: CalledNetwork, name: str) -> list[str]:
    """What the function of its values needs, and it, or that of its derivative, `name` being d and the network's."""
    constants, both = _Constants(network), name != network.name
    memory = ["s", "d"] if both else ["s"]
    lines = [f"double {', '.join(f'{m}[{network.starts[-1]} * GROUP]' for m in memory)};"]
    for k, m in enumerate(memory):
        lines += _loop(network.count, f"{m}[i * count + l] = q[{k * network.count} + i][l];")
    for part, start in zip(network.parts, network.starts, strict=False):
        lines += (_affine if isinstance(part, Affine) else _each)(constants, part, start, both)  # type: ignore[arg-type]
    lines += _loop(network.size, f"y[i][l] = {memory[-1]}[({constants.item(network.outputs)}) * count + l];")
    body = CALLED.format(name=name, lines="\n    ".join(lines))
    return [skeleton("affine.h"), "\n".join(text.replace("{name}", at) for text, at in constants.texts.items()), body]


def _affine(constants: _Constants, part: Affine, start: int, both: bool) -> list[str]:
    W, b = constants.name(part.W), constants.name(part.b)
    sizes, at = f"count, {len(part.W)}, {part.size}", f"{part.first} * count"
    lines = [f"affine({sizes}, s + {at}, {W}, {b}, s + {start} * count);"]
    return lines + [f"affine({sizes}, d + {at}, {W}, 0, d + {start} * count);"] * both


def _each(constants: _Constants, part: Each, start: int, both: bool) -> list[str]:
    outputs, _ = part.traced
    read = {}
    for k, operand in enumerate(part.operands):
        if operand.dtype.kind == "i":
            at = f"({constants.item(operand)}) * count + l"
            read |= {f"a{k}": f"s[{at}]", f"d{k}": f"d[{at}]"}
        elif (operand != operand[0]).any():
            read[f"a{k}"] = constants.item(operand)
    targets = [f"{m}[({start} + i) * count + l]" for m in "sd"]
    outputs = outputs[: 1 + both]
    return _loop(part.size, *map(statement, programs.lines(outputs, read, targets[: len(outputs)], TEXTS)))


def _loop(size: int, *lines: str) -> list[str]:
    """Lines for each of so many numbers, and each lane."""
    inner = [LOOP, *(f"    {line}" for line in lines), "}"]
    return [f"LANES for (int i = 0; i < {size}; i++) {{", *(f"    {line}" for line in inner), "}"]
