"""The parameters of a fit with their intervals, which what the delay leaves open widens."""

from typing import NamedTuple

import numpy as np

from npred import randomness
from npred.identification import estimate
from npred.identification.estimate import Delays
from npred.identification.preparation import Settings
from npred.plants import Plant

NORMAL = 1.96  # deviations of 95 %


class Parameter(NamedTuple):
    """A value with its interval of 95 %, and the correlation of its error with that of the nearest delay."""

    value: float
    low: float
    high: float
    correlation: float


def estimated(plant: Plant, delays: Delays, settings: Settings) -> tuple[dict[str, Parameter], dict[str, float]]:
    """What was asked for, by name; and how far the other parameters are from the plant's, in what was allowed."""
    prior, names = delays.problem.prior, [*plant.parameters, *(f"offset of {name}" for name in plant.inputs)]
    theta = delays.fit.thetas(np.ones((1, len(delays.fit.e))))[0]
    asked: dict[str, Parameter] = {}
    assumed: dict[str, float] = {}
    for k, row in enumerate(_rows(delays, theta, settings.seed)):
        name = names[delays.problem.model.free[k]]
        if np.isinf(prior.deviation[k]):
            asked[name] = row
        else:
            assumed[name] = float((theta[k] - prior.mean[k]) / prior.deviation[k])
    return asked, assumed


def _rows(delays: Delays, theta: np.ndarray, seed: int) -> list[Parameter]:
    """Each theta: the least interval that holds that of the cost's curvature and that of drawing the segments anew."""
    if not len(theta):
        return []
    rng, prior = randomness.generator(seed, "parameters"), delays.problem.prior
    draws, moved = [], []  # theta for each draw; how theta moves as a delay goes by its deviation
    for j, profile in enumerate(delays.profiles):
        draws += list(estimate.drawn(profile, rng)[1])
        near = np.flatnonzero(profile.costs - profile.costs.min() < 4 * delays.level)
        thetas = np.array([profile.fits[k].thetas(np.ones((1, len(delays.fit.e))))[0] for k in near])
        slope = np.polyfit(profile.values[near], thetas, 1)[0] if len(near) > 2 else np.zeros(len(theta))
        moved.append(slope * np.ptp(delays.interval[j]) / (2 * NORMAL))
    covariance = np.linalg.pinv(delays.fit.H.sum(axis=0) + np.diag(prior.weight)) * delays.inflation
    size = np.sqrt(np.diag(covariance) + np.square(moved).sum(axis=0))
    low, high = np.quantile(draws, estimate.SHARES, axis=0)
    low, high = np.minimum(low, theta - NORMAL * size), np.maximum(high, theta + NORMAL * size)
    low, high = (np.clip(ends, *prior.limits) for ends in (low, high))
    nearest = np.take_along_axis(np.array(moved), np.abs(moved).argmax(axis=0)[None], axis=0)[0]
    correlation = nearest / np.maximum(size, 1e-300)
    return [Parameter(*map(float, row)) for row in zip(theta, low, high, correlation, strict=True)]
