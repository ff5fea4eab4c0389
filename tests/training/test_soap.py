"""SOAP: Adam where there is nothing to turn, faster where there is, batches of matrices alike."""

import subprocess
import sys

import torch
from conftest import process_environment

from npred.lab.training.soap import BETA, EPS, EVERY, SOAP


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
