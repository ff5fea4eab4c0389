"""The content-addressed store of results."""

from npred.store import claims
from npred.store.artifacts import MARKER, Artifact, Store
from npred.store.manifest import Manifest, Question, ResultInput, short

__all__ = [
    "MARKER", "Artifact", "Manifest", "Question", "ResultInput", "Store", "claims", "short",
]  # fmt: skip
