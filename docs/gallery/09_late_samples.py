"""
Samples that come late
======================

On a real computer a call comes late, a command is lost and a sample is older
than a control step. ``npred.Timing`` has that, and the loop runs with the
controller that ships, on its clock: each call and each sample has a stamp.
"""

import numpy as np

import npred

plant = npred.plant("van_der_pol")
rk4 = npred.predictor(plant, "rk4", nx=51)
setting = {
    "D": 0.5,
    "D_hat": 0.3,
    "X0": [1.0, 0.0],
    "t_end": 15.0,
    "dt": 0.01,
    "adaptation": npred.DelayObserver(bounds=(0.1, 1.0)),
    "actuator": "history",
}

ideal = npred.simulate(plant, rk4, **setting)
real = npred.simulate(
    plant,
    rk4,
    **setting,
    timing=npred.Timing(jitter=0.3, lost=0.05),
    measurement=npred.Measurement(delay=0.1, drop=0.05),
)
axes = ideal.plot(D=0.5, label="on time")
real.plot(ax=axes, label="late and lost")
print(f"oldest sample that a step used: {1e3 * real.clock.age.max():.0f} ms")
print(f"D_hat at the end: {real.D_hat[-1]:.3f} s (D = 0.5 s)")
assert np.abs(real.X[-100:]).max() < 0.05

# %%
# The same from a program's own loop: give each call its time, and each sample
# the time when it was taken. ``None`` is no sample.

controller = npred.controller(
    plant, rk4, None, dt=0.01, D_hat=0.5, actuator="history"
)
controller.step([1.0, 0.0], t=0.000, sampled_at=0.000)
controller.step([1.0, 0.0], t=0.011, sampled_at=0.002)
controller.step(None, t=0.019)
print(f"age of the sample: {1e3 * controller.status.age:.0f} ms")
