"""Where things are unless told: one place for what the command line and the Python API both assume."""

import os
from pathlib import Path

PIPELINE = Path("pipeline/paper.toml")
STORE = Path("artifacts")
STORE_VARIABLE = "NPRED_STORE"
RESULT = "result.json"  # a stage's answer, among the files of its result
EXECUTOR_VARIABLE = "NPRED_EXECUTOR"


def store() -> Path:
    """The folder of the store: NPRED_STORE, or artifacts/ here."""
    return Path(os.environ.get(STORE_VARIABLE) or STORE)
