"""The network of a rig: a function of the seed and the packet's number, with the statistics that are asked for."""

import math

import numpy as np
import pytest
from scipy import stats

from npred.base.errors import ConfigError
from npred_rig.network import STOP, Channel

COUNT = 20_000


def waits(network: Channel, way: str = "samples", count: int = COUNT) -> np.ndarray:
    return np.array([network.arrival(way, k, 0.01 * k) - 0.01 * k for k in range(count)])


def test_delays_are_uniform_on_both_sides_of_the_mean():
    taken = waits(Channel(0.12, 0.02))
    assert stats.kstest(taken, stats.uniform(0.1, 0.04).cdf).pvalue > 0.01


def test_loss_and_slow_packets_have_their_shares():
    taken = waits(Channel(0.12, 0.0, loss=0.05, reorder=0.1))
    lost, slow = np.isinf(taken), np.isclose(taken, 0.24)
    for hits, share, of in ((lost.sum(), 0.05, COUNT), (slow.sum(), 0.1, (~lost).sum())):
        assert stats.binomtest(int(hits), int(of), share).pvalue > 0.01
    assert np.isclose(taken[~lost & ~slow], 0.12).all()


def test_a_packet_depends_on_its_number_alone_and_ways_and_seeds_differ():
    network = Channel(jitter=0.02, loss=0.1, seed=3)
    whole = waits(network)
    backwards = np.array([network.arrival("samples", k, 0.01 * k) - 0.01 * k for k in reversed(range(50))])
    assert np.array_equal(backwards[::-1], whole[:50])
    for other in (waits(network, "commands"), waits(Channel(jitter=0.02, loss=0.1, seed=4))):
        both = np.isfinite(whole) & np.isfinite(other)
        assert abs(stats.pearsonr(whole[both], other[both]).statistic) < 0.03


def test_packets_of_a_recorded_way_take_its_latencies():
    quantiles = ((0.0, 0.1), (0.5, 0.2), (1.0, 1.0))
    network = Channel(0.12, 0.02, seed=2, latencies={"samples": (0.3, math.inf, 0.1), "commands": quantiles})
    assert np.allclose(waits(network, count=6), [0.3, math.inf, 0.1] * 2) and network.longest == 1.0
    assert np.median(waits(network, "commands", 3000)) == pytest.approx(0.2, rel=0.05)
    assert Channel(0.12, 0.02, latencies={"samples": (0.01, math.inf)}).longest == pytest.approx(0.14)
    assert Channel(0.12, 0.02, latencies={"samples": 0.5}, reorder=0.1).longest == 1.0


def test_stops_lose_all_that_is_sent_in_them():
    network, grid = Channel(stops=30, seed=1), np.arange(0, 60, 0.001)
    stopped = np.array([network.stopped(t) for t in grid])
    begins = grid[1:][stopped[1:] & ~stopped[:-1]]
    assert len(begins) == 30
    assert stopped.mean() == pytest.approx(30 * STOP / 60, rel=0.01)
    assert network.arrival("samples", 7, begins[3] + STOP / 2) == math.inf


@pytest.mark.parametrize("wrong", [{"jitter": 0.2}, {"loss": 1.5}, {"delay": math.inf}, {"stops": 1e4}, {"delay": -1}])
def test_values_out_of_range_are_refused(wrong):
    with pytest.raises(ConfigError, match="network: expected"):
        Channel(**wrong)
