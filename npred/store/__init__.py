"""The content-addressed store of results."""

from npred.store import claims
from npred.store.artifacts import Artifact, Store
from npred.store.keys import short
from npred.store.manifest import Manifest, Question, Source

__all__ = ["Artifact", "Manifest", "Question", "Source", "Store", "claims", "short"]
