"""
The controller as C and as an FMU
=================================

The controller leaves npred as C99 without allocation, or as an FMU for a
simulation tool. What runs on the hardware is the text that ran here.
"""

import subprocess
import tempfile
from pathlib import Path

import npred

plant = npred.plant("van_der_pol")
heun = npred.predictor(plant, "heun", nx=31)
law = npred.DelayObserver(bounds=(0.1, 1.0))
loop = {"D": 0.3, "X0": [1.0, 0.0], "t_end": 8.0, "dt": 0.01}
run = npred.simulate(
    plant, heun, D_hat=0.6, adaptation=law, actuator="history", **loop
)
axes = run.plot(D=0.3)

# %%
controller = npred.controller(
    plant, heun, law, dt=0.01, D_hat=0.6, actuator="history"
)
folder = Path(tempfile.mkdtemp())
npred.export(controller, "controller", folder / "firmware")
npred.export(controller, "fmu", folder / "controller.fmu")
for path in sorted(folder.rglob("*")):
    if path.is_file():
        size = path.stat().st_size / 1e3
        print(f"{path.relative_to(folder)}: {size:.0f} kB")

# %%
# The C file has a self-test: steps of a loop, computed here and there.

source, program = folder / "firmware" / "npred.c", folder / "self_test"
flags = ["-std=c99", "-O2", "-DNPRED_TEST"]
subprocess.run(["cc", *flags, source, "-lm", "-o", program], check=True)
print(subprocess.run([program], capture_output=True, text=True).stdout)
