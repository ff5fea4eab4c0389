"""The optimisers that a CUDA graph can hold do what the plain ones do, for one network and for several side by side."""

import pytest
import torch

from npred.training.soap import EVERY, SOAP
from npred.training.stacked_optimisers import StackedAdam, StackedSOAP, turned_bases

SHAPES = [(4, 6), (6,), (4, 6), (3, 6, 4), (5, 5), (), (2, 4)]
STEPS = 3 * EVERY + 4
RATES = [0.05 * (1 + k % 3) for k in range(STEPS)]


def drawn(seed: int) -> list[torch.Tensor]:
    generator = torch.Generator().manual_seed(seed)
    return [torch.randn(shape, generator=generator, dtype=torch.float64) for shape in SHAPES]


def plainly(kind: str, seed: int, decay: float) -> tuple[list[torch.Tensor], torch.optim.Optimizer]:
    parameters = [p.requires_grad_() for p in drawn(seed)]
    optimiser = (
        SOAP(parameters, 0.0, decay) if kind == "soap"
        else torch.optim.Adam(parameters, lr=0.0, weight_decay=decay, fused=True)
    )  # fmt: skip
    for step, rate in enumerate(RATES):
        for p, G in zip(parameters, drawn(100 * seed + step), strict=True):
            p.grad = G
        optimiser.param_groups[0]["lr"] = rate
        optimiser.step()
    return [p.detach() for p in parameters], optimiser


def stacked(
    kind: str, seeds: list[int], decay: float, steps: range = range(STEPS)
) -> tuple[list[torch.Tensor], StackedAdam]:
    leaves = [torch.stack(each) for each in zip(*(drawn(seed) for seed in seeds), strict=True)]
    optimiser = {"soap": StackedSOAP, "adam": StackedAdam}[kind](leaves, decay, len(seeds))
    go_on(optimiser, seeds, steps)
    return leaves, optimiser


def go_on(optimiser: StackedAdam, seeds: list[int], steps: range) -> None:
    for step in steps:
        optimiser.set_rate(RATES[step])
        optimiser.update([torch.stack(each) for each in zip(*(drawn(100 * s + step) for s in seeds), strict=True)])
        optimiser.turn(step + 1)


@pytest.mark.parametrize("decay", [0.0, 0.1])
@pytest.mark.parametrize("kind", ["soap", "adam"])
def test_several_networks_side_by_side_are_each_on_its_own(kind: str, decay: float):
    leaves, optimiser = stacked(kind, [1, 2, 3], decay)
    for place, seed in enumerate((1, 2, 3)):
        expected, plain = plainly(kind, seed, decay)
        torch.testing.assert_close([leaf[place] for leaf in leaves], expected, rtol=1e-7, atol=1e-9)
        saved, here = plain.state_dict()["state"], optimiser.of(place).state_dict()["state"]
        assert {k: set(state) for k, state in saved.items()} == {k: set(state) for k, state in here.items()}
        for k, state in saved.items():
            for name in state.keys() - {"Q_left", "Q_right"}:  # whose columns have another sign
                torch.testing.assert_close(here[k][name], state[name], rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("kind", ["soap", "adam"])
def test_it_goes_on_from_the_state_of_either(kind: str):
    whole, last = stacked(kind, [1, 2], 0.1)
    half, before = stacked(kind, [1, 2], 0.1, range(STEPS // 2))
    resumed = type(before)(half, 0.1, 2)
    for place in range(2):
        resumed.of(place).load_state_dict(before.of(place).state_dict())
    go_on(resumed, [1, 2], range(STEPS // 2, STEPS))
    assert all(torch.equal(a, b) for a, b in zip(whole, half, strict=True))
    assert all(torch.equal(a, b) for a, b in zip(resumed.tensors(), last.tensors(), strict=True))


@pytest.mark.parametrize("kind", ["soap", "adam"])
def test_a_plain_optimiser_goes_on_from_a_graphs_state(kind: str):
    leaves, optimiser = stacked(kind, [1], 0.0, range(STEPS - 5))
    parameters = [leaf[0].clone().requires_grad_() for leaf in leaves]
    plain = SOAP(parameters, 0.0) if kind == "soap" else torch.optim.Adam(parameters, lr=0.0, fused=True)
    groups = plain.state_dict()["param_groups"]
    plain.load_state_dict(optimiser.of(0).state_dict() | {"param_groups": groups})
    for step in range(STEPS - 5, STEPS):
        for p, G in zip(parameters, drawn(100 + step), strict=True):
            p.grad = G
        plain.param_groups[0]["lr"] = RATES[step]
        plain.step()
    expected, _ = plainly(kind, 1, 0.0)
    torch.testing.assert_close([p.detach() for p in parameters], expected, rtol=1e-7, atol=1e-9)


def hard(n: int = 24) -> dict[str, torch.Tensor]:
    """Covariances that a factorisation of the Gram matrix alone would not survive, in single precision."""
    generator = torch.Generator().manual_seed(0)
    V = torch.linalg.qr(torch.randn(n, n, generator=generator, dtype=torch.float64))[0]
    low = torch.randn(n, 3, generator=generator, dtype=torch.float64)
    dead = low.clone()
    dead[: n // 2] = 0
    return {
        "none": torch.zeros(n, n),
        "of low rank": (low @ low.T).float(),
        "with dead units": (dead @ dead.T).float(),
        "over twelve decades": (V * torch.logspace(0, -12, n, dtype=torch.float64) @ V.T).float(),
        "tiny": (1e-30 * V @ V.T).float(),
        "one number": torch.ones(n, n),
    }


def test_bases_are_orthonormal_whatever_the_covariance():
    A, unit = torch.stack(list(hard().values())), torch.eye(24)
    Q = unit.expand_as(A)
    for _ in range(5):
        Q = turned_bases(A, Q)
        torch.testing.assert_close(Q.mT @ Q, unit.expand_as(A), rtol=0, atol=2e-6)


def test_bases_turn_as_those_of_a_qr_factorisation():
    torch.manual_seed(3)
    W = torch.randn(2, 9, 9, dtype=torch.float64)
    A, Q = W @ W.mT, torch.linalg.qr(torch.randn(2, 9, 9, dtype=torch.float64))[0]
    expected = torch.linalg.qr(A @ Q)[0]
    found = turned_bases(A, Q)
    torch.testing.assert_close((expected.mT @ found).abs(), torch.eye(9).double().expand_as(A), rtol=0, atol=1e-6)
