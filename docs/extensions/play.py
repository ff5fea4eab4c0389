"""The loops of docs/play.md as WebAssembly: the controller that `npred export controller` writes, and its plant, in C.

_static/play_loops.js of the built pages holds them, with their names and ranges. It is written only when they change.
"""

import base64
import hashlib
import json
import subprocess
import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

from sphinx.application import Sphinx
from sphinx.util import logging

import npred
from npred.exports import c_controller
from npred.kernels.kernel import skeleton
from npred.loop.controller import Controller
from npred.loop.engine import advance_kernel
from npred.prediction.methods import RK4

LOOP = Path(__file__).with_suffix(".c")
SCRIPTS, SHEET = ("play_loops.js", "play.js"), "play.css"
FLAGS = (
    "-target", "wasm32-wasi", "-mexec-model=reactor", "-std=c99", "-O2", "-Wl,--export=play", "-Wl,--strip-all",
    "-Wl,-z,stack-size=262144",
)  # fmt: skip
B = 1.0
logger = logging.getLogger(__name__)


class Scene(NamedTuple):
    """A plant of the page: its start, its control step and times in seconds, and what the sliders begin with.

    A slider is (first value, lowest, highest); that of gamma is logarithmic, and has 0 below its lowest. `axes` are the
    least ranges of the figures of the states and of U, `labels` their names and units.
    """

    plant: str
    title: str
    X0: tuple[float, ...]
    t_end: float
    dt: float
    nx: int
    every: int
    D: tuple[float, float, float]
    D_hat: tuple[float, float, float]
    gamma: tuple[float, float, float]
    noise: tuple[float, float, float]
    axes: tuple[tuple[float, float], ...]
    labels: tuple[str, ...]

    @property
    def steps(self) -> int:
        """Control steps of a loop; its first state comes before them."""
        return round(self.t_end / self.dt)


SCENES = (
    Scene(
        "activator_repressor", "Two proteins", (0.03, 30.0), 40.0, 0.01, 51, 5,
        D=(1.0, 0.1, 2.5), D_hat=(2.0, 0.1, 4.0), gamma=(1000.0, 10.0, 1e5), noise=(0.0, 0.0, 0.1),
        axes=((0.0, 0.2), (0.0, 30.0), (-0.1, 0.1)),
        labels=("x1, activator (no unit)", "x2, repressor (no unit)", "U, command (1/s)"),
    ),
    Scene(
        "van_der_pol", "Van der Pol's oscillator", (1.0, 0.0), 10.0, 0.005, 51, 4,
        D=(0.3, 0.05, 0.6), D_hat=(0.6, 0.05, 2.0), gamma=(0.2, 0.01, 100.0), noise=(0.0, 0.0, 0.1),
        axes=((-1.5, 1.5), (-2.0, 2.0), (-6.0, 6.0)),
        labels=("x1, position (no unit)", "x2, speed (1/s)", "U, command (1/s²)"),
    ),
)  # fmt: skip


def controller(scene: Scene) -> Controller:
    """The controller of a scene, with u measured, as the paper has it."""
    plant = npred.plant(scene.plant)
    law = npred.DelayAdaptation(gamma=scene.gamma[0], b=B, bounds=scene.D_hat[1:])
    return npred.controller(
        plant, npred.predictor(plant, "rk4", scene.nx), law, scene.dt, D_hat=scene.D_hat[0], actuator="measured"
    )


def source(scene: Scene) -> str:
    """The C of a scene in one text: the exported controller, the step of the plant, and the loop of both."""
    header, exported = c_controller.sources(controller(scene), tunable=True)
    advance = advance_kernel(npred.plant(scene.plant), RK4)
    start = ", ".join(map(repr, scene.X0))
    macros = {
        "STEPS": scene.steps, "EVERY": scene.every, "ROWS": round(scene.D[2] / scene.dt) + 4, "START": f"{{{start}}}",
        "ADVANCE": advance.name,
    }  # fmt: skip
    defined = [f"#define {name} {value}" for name, value in macros.items()]
    engine = map(skeleton, ("hold.h", "sensor_errors.h"))
    parts = [exported.replace('#include "npred.h"', header), *advance.texts, *engine, *defined]
    return "\n".join([*parts, LOOP.read_text(encoding="utf-8")])


def compiled(text: str) -> bytes:
    """The WebAssembly module of a text, by ziglang."""
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "loop.c").write_text(text, encoding="utf-8")
        words = [sys.executable, "-m", "ziglang", "cc", *FLAGS, "loop.c", "-o", "loop.wasm"]
        subprocess.run(words, cwd=folder, check=True, capture_output=True, text=True, timeout=600)
        return (Path(folder) / "loop.wasm").read_bytes()


def described(scene: Scene) -> dict[str, Any]:
    """The facts of a scene that the page shows, ready for JSON."""
    plant = npred.plant(scene.plant)
    names = {"states": list(plant.states), "inputs": list(plant.inputs), "rest": plant.equilibrium.tolist()}
    return scene._asdict() | names


def script(before: str = "", scenes: tuple[Scene, ...] = SCENES) -> str:
    """The text of play_loops.js: the scenes with their modules in base64; none of these without ziglang.

    `before` is the text of an earlier build, which is returned where nothing has changed.
    """
    texts = [source(scene) for scene in scenes]
    there = find_spec("ziglang") is not None
    head = "// " + hashlib.sha256("\n".join([*texts, repr(scenes), *FLAGS, str(there)]).encode()).hexdigest()
    if before.startswith(head):
        return before
    if not there:
        logger.info("play.md: expected the package ziglang, found none; the page says so")
    loops = [
        described(scene) | {"module": base64.b64encode(compiled(text)).decode() if there else ""}
        for scene, text in zip(scenes, texts, strict=True)
    ]
    return f"{head}\nconst LOOPS = {json.dumps(loops)};\n"


def write(app: Sphinx) -> None:
    """Write play_loops.js, where it has changed."""
    if app.builder.format != "html":
        return
    path = Path(app.outdir) / "_static" / SCRIPTS[0]
    before = path.read_text(encoding="utf-8") if path.exists() else ""
    if (text := script(before)) != before:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")


def add(app: Sphinx, page: str, template: str, context: dict[str, Any], tree: Any) -> None:
    """Let this page load its scripts and its style sheet, and no other page."""
    if page == "play":
        app.add_css_file(SHEET)
        for name in SCRIPTS:
            app.add_js_file(name, loading_method="defer")


def setup(app: Sphinx) -> dict[str, bool]:
    """Write the loops before the pages."""
    app.connect("builder-inited", write)
    app.connect("html-page-context", add)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
