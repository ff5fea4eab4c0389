"""Laws designed from f, for each shipped plant as if it declared no kappa: from which part of the box they converge.

    python benchmarks/laws.py [PLANT ...] [--laws lqr feedback_linearisation]

Loops are without delay, from 64 starts of the plant's box, then of the box shrunk by eighths about the target; the
sentence is that of `npred plants check PLANT --kappa LAW`. A law that does not fit a plant says why.
"""

import time

import harness

import npred
from npred import diagnosis, plants
from npred.diagnosis import Case

if __name__ == "__main__":
    options = harness.options(__doc__, {"plants": plants.names()}, laws=["lqr", "feedback_linearisation"])
    names, kept = options.plants, dict.fromkeys(options.laws, 0)
    either = 0
    for name in names:
        plant, verdicts = npred.plant(name), []
        for law in options.laws:
            began = time.perf_counter()
            answer = diagnosis.offer(law, plant, Case(plant, delay=1.0, nodes=101, samples=256))
            verdicts.append(answer.verdict)
            kept[law] += answer.verdict == "yes"
            print(f"{name}, {law}: {answer.text} ({time.perf_counter() - began:.0f} s)", flush=True)
        either += "yes" in verdicts
    for law, count in kept.items():
        print(f"{law} converges from half the box, or more, for {count} of {len(names)} plants")
    print(f"one of these laws does for {either} of {len(names)}")
