"""No tensor that may lie on a GPU becomes a NumPy array before it is fetched.

`tensor.numpy()` raises for one, on a GPU alone. So each call in the package says `.cpu()` before it or `force=True`,
but in the modules below, whose tensors are always the CPU's.
"""

import ast
from pathlib import Path

ROOT = Path(__file__).parent.parent
OF_THE_CPU = {
    "npred_experiments/bounds.py",  # its own search, on arrays
    "npred/lab/training/operators/scaling.py",  # made of arrays, before a network moves
    "npred_experiments/evolution.py",  # its own search, on arrays
}
SAVED = "npred/networks/"  # what is fused or exported was loaded from files, to the CPU
MODULES = [*(ROOT / "npred").rglob("*.py"), *ROOT.glob("npred_*/*.py")]


def unfetched(text: str) -> list[int]:
    """The lines of `x.numpy()` without `.cpu()` before it and without `force=True`."""
    calls = [node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Call)]
    named = [call for call in calls if isinstance(call.func, ast.Attribute) and call.func.attr == "numpy"]
    return [call.lineno for call in named if not call.keywords and not _fetched(call.func.value)]  # type: ignore[union-attr]


def _fetched(node: ast.expr) -> bool:
    """True if `.cpu()` is among the calls that the expression chains."""
    while isinstance(node, ast.Call | ast.Attribute):
        if isinstance(node, ast.Attribute) and node.attr == "cpu":
            return True
        node = node.func if isinstance(node, ast.Call) else node.value
    return False


def test_a_tensor_is_fetched_before_it_is_an_array():
    names = {path.relative_to(ROOT).as_posix(): path for path in MODULES}
    seen = {name: path for name, path in names.items() if name not in OF_THE_CPU and not name.startswith(SAVED)}
    found = [f"{name}:{line}" for name, path in seen.items() for line in unfetched(path.read_text())]
    assert names.keys() >= OF_THE_CPU and not found, "\n".join(found)


def test_an_unfetched_tensor_is_found():
    lines = [
        "a.numpy()",
        "b.cpu().numpy()",
        "c.cpu().flatten().numpy().data",
        "d.numpy(force=True)",
        "e.double().numpy()",
    ]
    assert unfetched("\n".join(lines)) == [1, 5]
