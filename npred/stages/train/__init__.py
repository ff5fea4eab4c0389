"""The networks."""

from npred.stages.declaration import Stage

STAGE = Stage(
    name="train",
    version=2,
    upstream=("generate",),
    result_class="npred.results:Trained",
    help="The networks, one artifact per network.",
    data=r"(model|domain)\.safetensors|model\.json|metrics\.jsonl|snapshot-\d+\.safetensors",
    per_network=True,
)
