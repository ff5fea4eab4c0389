"""The networks, one artifact per network."""

from npred.stages.declaration import Stage

STAGE = Stage(
    __name__,
    version=2,
    upstream=("generate",),
    result_class="npred.results:Trained",
    data=r"(model|domain)\.safetensors|model\.json|metrics\.jsonl|snapshot-\d+\.safetensors",
    per_network=True,
    needs="torch",
    summary_module="summary",
)
