"""The content-addressed store of results."""

from npred.lab.store import claims
from npred.lab.store.artifacts import MARKER, Artifact, Store
from npred.lab.store.manifest import Manifest, Question, ResultInput, short

__all__ = [
    "MARKER", "Artifact", "Manifest", "Question", "ResultInput", "Store", "claims", "short",
]  # fmt: skip
