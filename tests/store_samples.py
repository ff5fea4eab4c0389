"""Results in a store, and what a store holds."""

import json
from datetime import datetime
from pathlib import Path
from typing import Any

from npred.lab.store import Artifact, Question, ResultInput, Store
from npred.lab.store.manifest import sha256


def question(**changes: Any) -> Question:
    source = ResultInput(key="1" * 64, digest="2" * 64)
    fields: dict[str, Any] = {"stage": "train", "version": 1, "model": "fno", "config": {"seed": 0, "lr": 1e-3}}
    return Question(**({**fields, "inputs": {"generate": source}} | changes))


def put(store: Store, asked: Question | None = None, data: bytes = b"payload", pipeline: str = "p") -> Artifact:
    asked = asked or question()
    with store.draft(asked.stage, asked.key) as folder:
        (folder / "data.bin").write_bytes(data)
        (folder / "more").mkdir()
        (folder / "more" / "figure.svg").write_text("<svg/>")
        (folder / "result.json").write_text('{"mse": 0.5}')
        return store.commit(folder, asked, pipeline)


def made_at(folder: Path, moment: datetime | None) -> Path:
    """A result's folder, its manifest as if written at that moment; None: without a time."""
    fields = json.loads((folder / "manifest.json").read_text())
    del fields["checksum"], fields["provenance"]["made"]
    fields["provenance"] |= {} if moment is None else {"made": moment.isoformat()}
    fields["checksum"] = sha256(fields)
    (folder / "manifest.json").write_text(json.dumps(fields))
    return folder


def tree(root: Path) -> dict[str, bytes]:
    return {str(path): path.read_bytes() for path in root.rglob("*") if path.is_file()}
