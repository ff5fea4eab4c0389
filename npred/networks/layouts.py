"""The parameters of the networks with a fused form, by name and shape: what a file of weights has to hold.

Each function takes what the network's class takes, and has its defaults; a test compares them.
"""

from itertools import pairwise

Shapes = dict[str, tuple[int, ...]]
DEGREE = 12  # Legendre polynomials that the trunk sees: x alone gives a basis of almost straight lines at the start


def deeponet(
    n: int, m: int, clock: int = 0, *,
    width: int = 96, depth: int = 4, basis: int = 48, trunk: int = 64, moments: int = 16,
) -> Shapes:  # fmt: skip
    """npred.lab.training.operators.deeponet.DeepONetwork."""
    branch = [n + clock + moments * m + 1, *[width] * depth, n * (basis + m)]
    return _mlp("branch", branch, bias=False) | _mlp("trunk", [DEGREE, trunk, trunk, basis])


def fno(n: int, m: int, clock: int = 0, *, width: int = 32, modes: int = 8, layers: int = 4) -> Shapes:
    """npred.lab.training.operators.fno.FNOnetwork."""
    shapes = _linear("lift", n + clock + 1 + m + 1, width)
    for k in range(layers):
        shapes |= {f"spectral.{k}.{part}": (modes, width, width) for part in ("real", "imag")}
        shapes |= _linear(f"local.{k}", width, width)
    return shapes | _mlp("project", [width, 2 * width, n], bias=False)


def scaling(n: int, m: int) -> Shapes:
    """npred.lab.training.operators.scaling.Scaling."""
    sizes: Shapes = {"X": (n,), "u": (m,), "D_hat": (), "P": (n,)}
    shapes = {f"{name}_{part}": size for name, size in sizes.items() for part in ("mean", "std")}
    return shapes | {"X_bend": (n,), "speed": (n,)}


def _mlp(name: str, sizes: list[int], bias: bool = True) -> Shapes:
    """Linear layers of these sizes, an activation between them; `bias` is that of the last."""
    shapes, last = {}, len(sizes) - 2
    for k, (fan_in, fan_out) in enumerate(pairwise(sizes)):
        shapes |= _linear(f"{name}.{2 * k}", fan_in, fan_out, bias or k < last)
    return shapes


def _linear(name: str, fan_in: int, fan_out: int, bias: bool = True) -> Shapes:
    return {f"{name}.weight": (fan_out, fan_in)} | ({f"{name}.bias": (fan_out,)} if bias else {})
