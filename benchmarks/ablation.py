"""What each part of the recipe pays: the DeepONet of a pipeline with one part taken away at a time.

    python benchmarks/ablation.py [PIPELINE] [--epochs N] [--store DIR]

Every row is an ordinary result of the store, so an interrupted study goes on, and a second one is free. The table
goes to stdout as Markdown; docs/accuracy.md holds the last one.
"""

import json
import subprocess
import sys

import harness

ROWS: dict[str, list[str]] = {
    "the recipe": [],
    "anchor `initial`": ['train.deeponet.anchor="initial"'],
    "anchor `none`": ['train.deeponet.anchor="none"'],
    "squares for row norms": ['train.deeponet.rows="square"'],
    "loss `standardised` for `kappa`": ['train.deeponet.loss="standardised"'],
    "Adam (2e-3) for SOAP": ['train.deeponet.optimiser="adam"', "train.deeponet.lr=2e-3"],
    "no explorers, no redrawn D̂": ["generate.explore=0.0", "generate.redraw=0.0"],
}
COLUMNS = ("", "MSE", "ε sup", "ε κ", "ε relative, median", "radius: median", "worst", "converged", "settles")


def evaluate(pipeline: str, store: str, changes: list[str]) -> dict:
    """The row of the network in the evaluation of the pipeline with those changes."""
    sets = [word for change in changes for word in ("--set", change)]
    command = [sys.executable, "-m", "npred", "evaluate", pipeline, "--store", store, "--json", *sets]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True)
    return json.loads(done.stdout)["result"]["models"]["deeponet"]


def cells(name: str, row: dict) -> list[str]:
    """The row of the table."""
    radius, numbers = row["radius"], [row[key] for key in ("mse", "eps_sup", "eps_kappa")]
    numbers += [row["eps_relative"]["median"], radius["median"], radius["worst"]]
    settles = "–" if row["settle_ratio"] is None else f"{row['settle_ratio']:.2f}×"
    return [name, *("∞" if v is None else f"{v:.1e}" for v in numbers), f"{radius['converged']:.0%}", settles]


if __name__ == "__main__":
    asked = harness.options(__doc__, {"pipeline": "pipeline/paper.toml"}, epochs=12, store="artifacts")
    shared = ['train.models=["deeponet"]', f"train.deeponet.epochs={asked.epochs}", "train.deeponet.snapshots=[]"]
    shared += ["evaluate.map_D=[]", "evaluate.map_D_hat=[]"]  # the cases at D = 1 tell the rows apart
    harness.head(*COLUMNS)
    for name, changes in ROWS.items():
        harness.row(*cells(name, evaluate(asked.pipeline, asked.store, shared + changes)))
