"""The table [train], and those of the networks in it."""

from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, ConfigDict, Field, model_validator
from pydantic_core import PydanticCustomError

from npred.base.errors import unlisted
from npred.base.registry import METHODS, NETWORKS
from npred.lab.config.section import Anchor, Architecture, Count, Nodes, Positive, Section, Some

TAKEN = ("generate", "train", "evaluate", "bench", "report", "numerical", "no_adaptation", "published", "euler_python")
Networks = Annotated[Some[str], AfterValidator(lambda names: sorted(set(names)))]


class Training(Section):
    """The settings of all networks."""

    epochs: Count = 100  #: passes over the data; with `eps` the largest number
    eps: Positive | None = None  #: training ends at this largest held-out error of P
    batch: Count = 1024  #: rows per step
    lr: Positive = 1e-2  #: learning rate, at its peak
    weight_decay: Annotated[float, Field(ge=0, strict=True)] = 0.0  #: decay of the weights towards 0
    optimiser: Literal["soap", "adam"] = "soap"  #: SOAP or Adam
    schedule: Literal["one-cycle", "step"] = "one-cycle"  #: the learning rate's course; step halves it every 50 epochs
    loss: Literal["raw", "standardised", "kappa"] = "kappa"  #: weights of components; kappa: by their effect on U
    rows: Literal["square", "norm"] = "norm"  #: mean over rows of squares or norms
    nodes: Nodes | None = None  #: number of nodes on which P is compared; all by default
    snapshots: list[Count] = []  #: epochs after which the model is stored
    anchor: Anchor = "equilibrium"  #: where P_hat is exact by construction
    checkpoint_every: Count = 5  #: epochs between checkpoints

    @model_validator(mode="after")
    def _check_snapshots(self) -> Self:
        late = [k for k in self.snapshots if k > self.epochs]
        if late:
            cure = "raise epochs or drop it"
            raise ValueError(f"snapshots: expected epochs of 1 to {self.epochs}, got {late[0]}; {cure}")
        if self.snapshots and self.eps:
            raise ValueError("snapshots: expected none beside eps, with which a training may end before; drop one")
        return self

    @property
    def architecture(self) -> str:
        """The network that is trained, as the registry names it: where a table does not say, the name of the table."""
        return getattr(self, "network", type(self).__name__.lower())

    @property
    def arguments(self) -> dict[str, Any]:
        """The keyword arguments of the network's class: `sizes`, or else the keys beyond those of Training."""
        keywords = {key: value for key, value in self if key not in Training.model_fields}
        return keywords.get("sizes", keywords)


class DeepONet(Training):
    """Branch network of `depth` hidden layers, trunk of two; `basis` trunk functions; `moments` of u."""

    width: Count = 96  #: width of the branch network
    depth: Count = 4  #: hidden layers of the branch
    basis: Count = 48  #: trunk functions
    trunk: Count = 64  #: width of the trunk network
    moments: Count = 16  #: Legendre moments of u that the branch sees


class FNO(Training):
    """Spectral layers over x [Li et al. 2021], each a truncated real DFT of the lowest `modes`."""

    batch: Count = 256  #: rows per step
    lr: Positive = 5e-3  #: learning rate
    width: Count = 32  #: channels
    modes: Count = 8  #: modes of each spectral layer
    layers: Count = 4  #: spectral layers


class Network(Training):
    """A network with a name of your choice."""

    network: Architecture  #: a registered one, one of a package, or `file.py:Class`; by default the table's name
    sizes: dict[str, Any] = {}  #: keyword arguments of the network's class


class Train(Section):
    """One table per network. A registered network needs no table."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, Network] = Field(init=False)

    models: Networks = ["deeponet", "fno"]  #: registered networks or names of tables
    deeponet: DeepONet = DeepONet()
    fno: FNO = FNO()

    @property
    def named(self) -> dict[str, Network]:
        """The tables of names that the user has chosen."""
        return self.__pydantic_extra__

    @property
    def names(self) -> list[str]:
        """The networks that can be trained: those with a table, and the registered ones."""
        return list(dict.fromkeys(["deeponet", "fno", *self.named, *NETWORKS.names()]))

    def table(self, name: str) -> Training:
        """The table of a network; a registered one may have none."""
        if name in type(self).model_fields:
            return getattr(self, name)
        return self.named[name] if name in self.named else Network(network=name)

    @model_validator(mode="before")
    @classmethod
    def _named(cls, data: Any) -> Any:
        """Each table of a chosen name with its `network`, the name itself where it gives none."""
        if not isinstance(data, dict):
            return data
        chosen = {key: table for key, table in data.items() if key not in cls.model_fields}
        for key, table in chosen.items():
            if not isinstance(table, dict | Network):
                raise PydanticCustomError("extra_forbidden", "{key}", {"key": key})
            if not key.isidentifier() or len(key) > 100 or key in (*TAKEN, *METHODS.names()):
                what = f"{key}: expected the name of a network, of letters, digits and _, and none that results use"
                cure = "choose another"
                raise ValueError(f"{what}, got {key!r}; {cure}")
        return data | {k: {"network": k} | table for k, table in chosen.items() if isinstance(table, dict)}

    @model_validator(mode="after")
    def _check_models(self) -> Self:
        for name in set(self.models) - {*self.named, *NETWORKS.builtin}:
            if name not in self.names:
                raise ValueError(unlisted("models", name, self.names, todo="choose one or add a table [train.NAME]"))
        return self
