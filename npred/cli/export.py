"""`npred export` of a trained model: a file for another program, checked on held-out samples."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from npred.cli import data_exchange, export_controller
from npred.cli.export_controller import Choices
from npred.cli.options import Common, writable
from npred.data import shards
from npred.errors import ConfigError
from npred.pipeline import Stored
from npred.runtimes import c_network, onnx
from npred.runtimes.probe import Probe, probe

NX = 101  # nodes of a model's file
COMPARED = 200  # held-out samples


def export(
    options: Common, form: str, key: str, output: Path | None, nx: int | None, atol: float, fmi: int, mex: bool,
    **controller: Any
) -> None:  # fmt: skip
    """Write the file. Raises ConfigError for a format that there is none of, NpredError for a graph that differs."""
    if nx is not None and nx < 2:
        raise ConfigError(f"--nx: expected at least 2 nodes, both ends of [0, 1], got {nx}; dx = 0.01 is nx = 101")
    choices = Choices(nx=nx, **controller)
    forms: dict[str, Callable[[], None]] = {
        **dict.fromkeys(("onnx", "c"), lambda: _model(options, form, key, output, nx or NX, atol)),
        "controller": lambda: export_controller.export(options, key, output, choices, mex),
        "fmu": lambda: export_controller.export_fmu(options, key, output, choices, fmi),
        **dict.fromkeys(data_exchange.WRITERS, lambda: data_exchange.export(options, form, key, output)),
    }
    if form not in forms:
        raise ConfigError(f"export: expected one of {', '.join(forms)}, got {form!r}; name one of them")
    forms[form]()


def _model(options: Common, form: str, key: str, output: Path | None, nx: int, atol: float) -> None:
    """P and U of a trained model as a file, compared on held-out samples where it can be run here."""
    stored, operator = export_controller.loaded(options, key)
    path = writable(output or Path(f"{stored.model}-{nx}.{form}"))
    samples = _samples(options, stored, COMPARED, nx)
    document = {"file": str(path), "format": form, "model": stored.model, "nx": nx}
    if form == "c":
        errors = c_network.export(operator, stored.plant, path, nx, samples)
    else:
        errors = onnx.export(operator, stored.plant, path, nx, samples, atol)
    if errors:
        document |= {"error": errors[0], "eps": errors[1], "samples": len(samples[0])}
    options.show(document, lambda: _summary(document))


def _samples(options: Common, stored: Stored, count: int, nx: int) -> Probe:
    """Held-out samples of the data that the model was trained on, verified."""
    source = options.results.find(str(stored.folder)).manifest.question.inputs["generate"]
    data = options.results.get("generate", source.key)
    if data is None:
        raise ConfigError(
            f"export: expected the model's data {source.key[:12]} in {options.store}, got none; generate it"
        )
    return probe(shards.survey(data.verify().folder / "data.h5").subset(test=True), count, nx)


def _summary(document: dict[str, object]) -> str:
    line = f"{document['file']}: P and U of {document['model']} on {document['nx']} nodes"
    if "error" not in document:
        return f"{line}; not compared, for there is no C compiler here"
    on = f"on {document['samples']} held-out samples"  # not all of evaluate's, nor on its nodes: not its ε sup
    return f"{line}; {on} within {document['error']:.2g} of the model, whose error there is {document['eps']:.2g}"
