"""An exported controller on a Cortex-M: flash, RAM, stack and instructions per step, and whether it computes the same.

    python benchmarks/cortex_m.py pipeline/paper.toml:deeponet --store artifacts

It exports the controller of the pipeline's evaluated loop, one with a safety filter, and one whose law is a policy (of
npred[onnx]), cross-compiles them with arm-none-eabi-gcc -O2 and runs them in QEMU (mps2-an386, a Cortex-M4F, in float;
mps2-an500, a Cortex-M7, in double).
Flash and RAM are those of a program with nothing else, the C library's functions included; the stack is what the steps
overwrite of a painted one. With `-icount` QEMU's clock runs 1 ns per instruction and SysTick counts it at 25 MHz, which
gives instructions, not cycles: QEMU has no pipeline, no cache and no flash that is slow.
"""

import json
import re
import subprocess
import sys
import tempfile
from importlib import import_module
from pathlib import Path

import harness
import plants

import npred
from npred.exports import c_controller
from npred.loop.controller import Controller

ASSETS = Path(__file__).parent / "cortex_m"
BOARDS = {
    "float": ("mps2-an386", ["-mcpu=cortex-m4", "-mfpu=fpv4-sp-d16"]),
    "double": ("mps2-an500", ["-mcpu=cortex-m7", "-mfpu=fpv5-d16"]),
}
TOOLS = ("arm-none-eabi-gcc", "arm-none-eabi-size", "qemu-system-arm")
PER_TICK = 40  # instructions: a tick of SysTick at 25 MHz has 40 ns


def measure(folder: Path, precision: str) -> dict[str, float]:
    """Flash, RAM, stack in bytes, instructions per step, and the largest difference of U from the host's, of its size.

    `folder` holds npred.h and npred.c. Raises SystemExit where a compiler or QEMU fails.
    """
    board, cpu = BOARDS[precision]
    measured = "npred_step_nodes" in (folder / "npred.h").read_text()
    u = "(const npred_real *)measured + NPRED_N_STATES," if measured else ""
    define = [f"-Dnpred_real={precision}", f"-DMEASURED_FROM={u}"]
    cross = ["arm-none-eabi-gcc", "-std=gnu99", "-O2", "-mthumb", "-mfloat-abi=hard", *cpu, *define, f"-I{folder}"]
    link = ["-nostartfiles", "-specs=nosys.specs", "-ffunction-sections", "-fdata-sections", "-Wl,--gc-sections"]
    link += [f"-T{ASSETS / 'mps2.ld'}", "-Wl,--no-warn-rwx-segments"]
    bare, tested, host = (folder / name for name in ("bare.elf", "tested.elf", "host"))
    sources = [str(ASSETS / "bare.c"), str(folder / "npred.c")]
    _run([*cross, *link, *sources, "-o", str(bare), "-lm"])
    _run([*cross, *link, str(ASSETS / "main.c"), "-o", str(tested), "-lm"])
    _run(["gcc", "-std=gnu99", "-O2", *define, f"-I{folder}", str(ASSETS / "main.c"), "-o", str(host), "-lm"])
    qemu = ["qemu-system-arm", "-M", board, "-nographic", "-monitor", "none", "-icount", "shift=0,sleep=off"]
    lines = _run([*qemu, "-semihosting-config", "enable=on,target=native", "-kernel", str(tested)]).splitlines()
    there, here = ([int(word) for word in line.split()] for line in (lines[0], _run([str(host)])))
    steps, ticks, stack = map(int, lines[1].split())
    flash, data = map(int, _run(["arm-none-eabi-size", str(bare)]).splitlines()[1].split()[:2])
    symbols = _run(["arm-none-eabi-nm", "-S", str(bare)])
    state = re.findall(r"^\w+ (\w+) [bB] controller$", symbols, re.MULTILINE)[0]
    difference = max(abs(a - b) for a, b in zip(there, here, strict=True)) * 1e-9
    return {
        "flash": flash + data, "ram": data + int(state, 16), "stack": stack,
        "instructions": ticks * PER_TICK / steps, "difference": difference,
    }  # fmt: skip


def _run(command: list[str]) -> str:
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, timeout=300)
    if done.returncode:
        raise SystemExit(f"{' '.join(command)}:\n{done.stdout}")
    return done.stdout


def rows(model: str, nx: int) -> dict[tuple[str, str], list[str]]:
    """The exports by name and precision."""
    pipeline = model.rpartition(":")[0]
    guard, heun = ["--guard", "0.01"], [pipeline, "--predictor", "heun"]
    kinds = {"network": [model], "network, guard": [model, *guard], "heun": heun, "heun, guard": [*heun, *guard]}
    return {
        (kind, precision): [*arguments, "--nx", str(nx), "--precision", precision, "--actuator", "history"]
        for precision in BOARDS
        for kind, arguments in kinds.items()
    }


def filtered() -> Controller:
    """A cart whose law overshoots the end of its track, with a safety filter."""
    plant = npred.plant(plants.Cart)
    heun, kept = npred.predictor(plant, "heun", 31), npred.SafetyFilter()
    return npred.controller(plant, heun, None, 0.01, D_hat=0.3, actuator="history", safety=kept)


def learned(folder: Path) -> Controller:
    """A pendulum whose law is a policy of 64 x 64, with RK4 on 20 steps; its file is put into the folder."""
    sys.path.insert(0, str(harness.ROOT / "tests"))
    policies = import_module("policies")
    plant = type("Pendulum", (), {
        "states": ("angle", "rate"), "inputs": ("torque",), "box": {"angle": (-1.0, 1.0), "rate": (-1.0, 1.0)},
        "f": lambda x, u, t, p, M: [x.rate, M.sin(x.angle) - 0.2 * x.rate + u.torque],
        "observation": lambda x, u, t, p, M: [M.cos(x.angle), M.sin(x.angle), x.rate],
    })  # fmt: skip
    policies.torch.manual_seed(0)
    actor = policies.mlp([3, 64, 64, 1], policies.nn.Tanh).eval()
    plant = npred.plant(plant, kappa=str(policies.exported(actor, 3, folder / "pendulum.onnx")))
    return npred.controller(plant, npred.predictor(plant, "rk4", 21), None, 0.02, D_hat=0.2)


def write(controller: Controller, precision: str, folder: Path) -> None:
    """Put npred.h and npred.c of a controller into the folder."""
    for text, suffix in zip(c_controller.sources(controller, precision=precision), "hc", strict=True):
        (folder / f"npred.{suffix}").write_text(text)


def main() -> None:
    options = harness.options(__doc__, {"model": ...}, store=Path("artifacts"), nx=101, json=False)
    results = {}
    for (kind, precision), arguments in rows(options.model, options.nx).items():
        with tempfile.TemporaryDirectory() as name:
            harness.command_line("export", "controller", *arguments, "--store", str(options.store), "-o", name)
            results[f"{kind}, {precision}"] = measure(Path(name), precision)
    for precision in BOARDS:
        with tempfile.TemporaryDirectory() as name:
            for kind, controller in {"heun, filter": filtered(), "rk4, policy": learned(Path(name))}.items():
                write(controller, precision, Path(name))
                results[f"{kind}, {precision}"] = measure(Path(name), precision)
    if options.json:
        print(json.dumps(results, indent=2))
        return
    print(f"{'':24} flash KiB  RAM KiB  stack B  instructions per step  largest difference of U")
    for kind, row in results.items():
        sizes = f"{row['flash'] / 1024:9.1f} {row['ram'] / 1024:8.1f} {row['stack']:8.0f}"
        print(f"{kind:24} {sizes} {row['instructions']:22.0f} {row['difference']:24.1e}")


if __name__ == "__main__":
    main()
