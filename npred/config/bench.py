"""The table [bench]."""

from typing import Annotated

from pydantic import Field

from npred.config.section import ADDED, Baseline, Count, Positive, Runtime, Section, Some


class Bench(Section):
    """Table I of [DAPF]: calls at each dx, each predictor with its error beside its time.

    Batches above 1 are timed at the first dx. `calls` of a predictor end after `seconds`.
    """

    dx: Some[Annotated[float, Field(gt=0, le=0.5)]] = [0.01, 0.005, 0.001]  #: spacings of the nodes
    calls: Count = 20_000  #: timed calls of a predictor: of 1000, one alone is beyond 99.9 %
    seconds: Positive = 3.0  #: after which they end
    threads: Count = 1  #: of each library
    batches: Some[Count] = [1, 1024]  #: rows per call
    runtimes: Some[Runtime] = ["torch", "fused", "onnx"]  #: ways to evaluate a network; also `file.py:Class`
    #: predictors in Python to compare with, `file.py:Class`; timed at batch 1
    baselines: Annotated[list[Baseline], ADDED] = []
