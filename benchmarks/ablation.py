"""What each part of the recipe pays: the DeepONet of a pipeline with one part taken away at a time.

    python benchmarks/ablation.py [PIPELINE] [--epochs N] [--store DIR]

Every row is an ordinary result of the store, so an interrupted study goes on, and a second one is free. The table
goes to stdout as Markdown; docs/accuracy.md holds the last one.
"""

import argparse
import json
import subprocess
import sys

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


def line(name: str, row: dict) -> str:
    """The row as Markdown."""
    radius = row["radius"]
    numbers = [
        row["mse"],
        row["eps_sup"],
        row["eps_kappa"],
        row["eps_relative"]["median"],
        radius["median"],
        radius["worst"],
    ]
    cells = [name, *("∞" if v is None else f"{v:.1e}" for v in numbers), f"{radius['converged']:.0%}"]
    cells.append("–" if row["settle_ratio"] is None else f"{row['settle_ratio']:.2f}×")
    return "| " + " | ".join(cells) + " |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("pipeline", nargs="?", default="pipeline/paper.toml")
    parser.add_argument("--epochs", type=int, default=12)
    parser.add_argument("--store", default="artifacts")
    asked = parser.parse_args()
    shared = ['train.models=["deeponet"]', f"train.deeponet.epochs={asked.epochs}", "train.deeponet.snapshots=[]"]
    shared += ["evaluate.map_D=[]", "evaluate.map_D_hat=[]"]  # the cases at D = 1 tell the rows apart
    print("| " + " | ".join(COLUMNS) + " |\n|" + "---|" * len(COLUMNS), flush=True)
    for name, changes in ROWS.items():
        print(line(name, evaluate(asked.pipeline, asked.store, shared + changes)), flush=True)


if __name__ == "__main__":
    main()
