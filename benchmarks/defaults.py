"""Each built-in plant, and the tutorial's tank, in a pipeline that gives nothing but D: is the adaptive loop kept?

The gain, the bounds and the first estimates are derived from the plant and D, and the loops are those of the check
before a run: 3 starts of the box times the first estimates 0.3 D to 2 D. `python benchmarks/defaults.py [PLANT=D …]`
prints a row for each: the gain, and what is found, or what to give. The larger arms take minutes to compile.
"""

import re
import sys
import tempfile
from pathlib import Path

from npred import plants
from npred.base.errors import ConfigError
from npred.lab import config
from npred.lab.config import conditions
from npred.lab.scheduler import pipeline_fit

TUTORIAL = Path(__file__).parent.parent / "docs" / "own_plant.md"
SECONDS = {  # D of the plants' pipelines and pages, else 0.5 s
    "activator_repressor": 1.0, "cart_pole": 0.2, "chemostat": 1.5, "scalar": 1.0, "strict_feedforward2": 1.0,
    "strict_feedforward3": 1.0, "van_der_pol": 1.0, "xarm6": 0.1,
}  # fmt: skip


def tank() -> str:
    """The plant of the tutorial, in a file of its own."""
    block = re.search(r"```python\n(# my_plant\.py.*?)```", TUTORIAL.read_text(encoding="utf-8"), re.DOTALL)
    path = Path(tempfile.mkdtemp()) / "my_plant.py"
    path.write_text(block[1] if block else "", encoding="utf-8")
    return f"{path}:Tank"


def row(name: str, D: float) -> tuple[float | None, str]:
    """The gain, and the sentence of the check before a run."""
    tables = {"generate": {"D": D}, "evaluate": {"D": D}}
    pipeline = config.parse({"plant": tank() if name == "tank" else name} | tables, "benchmark")
    plant = plants.resolve(pipeline.plant, {})
    if plant.declares_delay:
        return None, "declares its delay: nothing is estimated"
    try:
        pipeline_fit.require(plant, pipeline, ("generate",))
        law = conditions.adaptation(pipeline.evaluate, plant)
        return (law.gamma if law else None), "; ".join(pipeline_fit.doubts(plant, pipeline)) or "converges"
    except ConfigError as error:
        return None, str(error)


if __name__ == "__main__":
    names = [plant["name"] for plant in plants.named()] + ["tank"]
    asked = dict(pair.split("=") for pair in sys.argv[1:]) or {name: SECONDS.get(name, 0.5) for name in names}
    print("| plant | D, s | gamma | |\n|---|---|---|---|")
    for name, D in asked.items():
        gamma, found = row(name, float(D))
        print(f"| {name} | {float(D):g} | {'–' if gamma is None else f'{gamma:g}'} | {found} |", flush=True)
