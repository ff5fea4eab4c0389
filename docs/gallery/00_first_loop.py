"""
A first loop
============

An oscillator whose input arrives 0.3 s late. The law that would hold it at rest
makes it swing; on the predicted state the same law holds it. The delay is not
known to the controller: it begins at 0.6 s and finds 0.3 s.
"""

import npred

plant = npred.plant("van_der_pol")
rk4 = npred.predictor(plant, "rk4")
loop = {"D": 0.3, "X0": [1, 0], "t_end": 12, "actuator": "history"}
law = npred.DelayObserver(bounds=(0.05, 1))
lost = npred.simulate(plant, rk4, D_hat=0, **loop)
kept = npred.simulate(plant, rk4, D_hat=0.6, adaptation=law, **loop)
axes = lost.plot(label="without prediction")
kept.plot(D=0.3, ax=axes, label="with prediction")
