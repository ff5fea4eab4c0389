"""SOAP, and the optimisers that a CUDA graph can hold: as the plain ones, and on from their state."""

import subprocess
import sys

import pytest
import torch
from conftest import process_environment

from npred.lab.training.soap import BETA, EPS, EVERY, SOAP, GraphSOAP, turned_bases


def losses(build, W: torch.Tensor, steps: int) -> list[float]:
    """Of |A W B - C|^2, badly conditioned along directions that are no axes."""
    torch.manual_seed(0)
    turn_A, turn_B = (torch.linalg.qr(torch.randn(8, 8))[0] for _ in range(2))
    scale = torch.logspace(0, -1.5, 8)
    A, B, C = turn_A * scale @ turn_A.T, turn_B * scale @ turn_B.T, torch.randn(8, 8)
    C = A @ C @ B
    W = W.clone().requires_grad_()
    optimiser, found = build([W]), []
    for _ in range(steps):
        loss = (A @ W @ B - C).square().sum()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        found.append(float(loss.detach()))
    return found


def test_a_vector_is_left_to_adam():
    runs = []
    for build in (lambda p: SOAP(p, lr=0.1), lambda p: torch.optim.Adam(p, lr=0.1, betas=(BETA, BETA), eps=EPS)):
        v = torch.ones(3, requires_grad=True)
        optimiser = build([v])
        for _ in range(20):
            optimiser.zero_grad()
            (v.square() * torch.tensor([1.0, 5.0, 9.0])).sum().backward()
            optimiser.step()
        runs.append(v.detach())
    torch.testing.assert_close(runs[0], runs[1], rtol=1e-4, atol=1e-5)


def test_turned_axes_cost_it_less_than_adam():
    start = torch.zeros(8, 8)
    soap = losses(lambda p: SOAP(p, lr=0.05), start, 200)
    adam = losses(lambda p: torch.optim.Adam(p, lr=0.05, betas=(BETA, BETA)), start, 200)
    assert soap[-1] < 0.5 * adam[-1] < 0.5 * adam[0]


def test_a_batch_of_matrices_is_each_on_its_own():
    torch.manual_seed(1)
    gradients = torch.randn(2 * EVERY + 1, 3, 4, 5)
    together = torch.zeros(3, 4, 5, requires_grad=True)
    alone = [torch.zeros(4, 5, requires_grad=True) for _ in range(3)]
    all_at_once, one_by_one = SOAP([together], lr=0.1), SOAP(alone, lr=0.1)
    for G in gradients:
        together.grad = G
        for W, g in zip(alone, G, strict=True):
            W.grad = g.clone()
        all_at_once.step()
        one_by_one.step()
    torch.testing.assert_close(together.detach(), torch.stack([W.detach() for W in alone]), rtol=1e-4, atol=1e-5)


def test_weight_decay_is_decoupled():
    W = torch.ones(2, 2, requires_grad=True)
    W.grad = torch.zeros(2, 2)
    SOAP([W], lr=0.1, weight_decay=0.5).step()
    torch.testing.assert_close(W.detach(), torch.full((2, 2), 0.95))


def test_it_does_not_import_the_compiler_of_torch():
    program = """\
import sys, torch
from npred.lab.training.soap import SOAP
W = torch.ones(2, 2, requires_grad=True)
optimiser = SOAP([W], lr=0.1)
for _ in range(2):
    optimiser.zero_grad()
    W.square().sum().backward()
    optimiser.step()
other = SOAP([W], lr=0.1)
other.load_state_dict(optimiser.state_dict())
print(float(W.grad[0, 0]), float(other.state[W]["step"]), "torch._dynamo" in sys.modules)
"""
    done = subprocess.run([sys.executable, "-c", program], env=process_environment(), capture_output=True, text=True)
    assert (done.stdout.split()[1:], done.stderr) == (["2.0", "False"], "")


SHAPES = [(4, 6), (6,), (4, 6), (3, 6, 4), (5, 5), (), (2, 4)]
STEPS = 3 * EVERY + 4
RATES = [0.05 * (1 + k % 3) for k in range(STEPS)]


def drawn(seed: int) -> list[torch.Tensor]:
    generator = torch.Generator().manual_seed(seed)
    return [torch.randn(shape, generator=generator, dtype=torch.float64) for shape in SHAPES]


def optimiser(kind: str, parameters: list[torch.Tensor], decay: float) -> torch.optim.Optimizer:
    rate = torch.zeros((), dtype=torch.float64)
    adam = {"weight_decay": decay, "fused": True}
    makers = {
        "soap": lambda: SOAP(parameters, 0.0, decay),
        "adam": lambda: torch.optim.Adam(parameters, lr=0.0, **adam),
        "soap in a graph": lambda: GraphSOAP(parameters, rate, decay),
        "adam in a graph": lambda: torch.optim.Adam(parameters, rate, capturable=True, **adam),
    }
    return makers[kind]()


def go_on(optimiser: torch.optim.Optimizer, seed: int, steps: range) -> None:
    group = optimiser.param_groups[0]
    for step in steps:
        for p, G in zip(group["params"], drawn(100 * seed + step), strict=True):
            p.grad = G
        group["lr"] = group["lr"].fill_(RATES[step]) if isinstance(group["lr"], torch.Tensor) else RATES[step]
        optimiser.step()
        if isinstance(optimiser, GraphSOAP) and (step + 1) % EVERY == 0:
            optimiser.turn()


def trained(
    kind: str, seed: int, decay: float, steps: range = range(STEPS)
) -> tuple[list[torch.Tensor], torch.optim.Optimizer]:
    parameters = [p.requires_grad_() for p in drawn(seed)]
    trains = optimiser(kind, parameters, decay)
    go_on(trains, seed, steps)
    return parameters, trains


def values(tensors: list[torch.Tensor]) -> list[torch.Tensor]:
    return [tensor.detach() for tensor in tensors]


@pytest.mark.parametrize("decay", [0.0, 0.1])
@pytest.mark.parametrize("kind", ["soap", "adam"])
def test_what_a_graph_holds_trains_as_the_plain_optimiser(kind: str, decay: float):
    for seed in (1, 2, 3):
        expected, plain = trained(kind, seed, decay)
        found, graph = trained(f"{kind} in a graph", seed, decay)
        torch.testing.assert_close(values(found), values(expected), rtol=1e-7, atol=1e-9)
        saved, here = plain.state_dict()["state"], graph.state_dict()["state"]
        assert {k: set(state) for k, state in saved.items()} == {k: set(state) for k, state in here.items()}
        for k, state in saved.items():
            for name in state.keys() - {"Q_left", "Q_right"}:  # whose columns have another sign
                torch.testing.assert_close(here[k][name], state[name], rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("kind", ["soap in a graph", "adam in a graph"])
def test_it_goes_on_from_its_state_to_the_bit(kind: str):
    whole, last = trained(kind, 1, 0.1)
    half, before = trained(kind, 1, 0.1, range(STEPS // 2))
    resumed = optimiser(kind, half, 0.1)
    resumed.load_state_dict(before.state_dict())
    go_on(resumed, 1, range(STEPS // 2, STEPS))
    assert all(torch.equal(a, b) for a, b in zip(whole, half, strict=True))
    found, expected = (each.state_dict()["state"] for each in (resumed, last))
    assert all(torch.equal(found[k][name], tensor) for k, state in expected.items() for name, tensor in state.items())


@pytest.mark.parametrize("graph_first", [True, False])
@pytest.mark.parametrize("kind", ["soap", "adam"])
def test_either_goes_on_from_the_others_state(kind: str, graph_first: bool):
    kinds = [f"{kind} in a graph", kind] if graph_first else [kind, f"{kind} in a graph"]
    parameters, before = trained(kinds[0], 1, 0.0, range(STEPS - 5))
    resumed = optimiser(kinds[1], parameters, 0.0)
    groups = resumed.state_dict()["param_groups"]
    resumed.load_state_dict({"state": before.state_dict()["state"], "param_groups": groups})
    go_on(resumed, 1, range(STEPS - 5, STEPS))
    torch.testing.assert_close(values(parameters), values(trained(kind, 1, 0.0)[0]), rtol=1e-7, atol=1e-9)


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
