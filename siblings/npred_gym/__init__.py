"""Policies whose actions act late, in Gymnasium's environments. Extra: npred[gym]."""

from npred.base.errors import required

required("npred_gym", "gymnasium", "gymnasium", "gym")

from npred_gym.ahead import Ahead  # noqa: E402
from npred_gym.black_box import plant, record  # noqa: E402
from npred_gym.delayed import DelayedActions  # noqa: E402
from npred_gym.model import Model  # noqa: E402
from npred_gym.simulator import Simulator  # noqa: E402
from npred_gym.states import state_of  # noqa: E402

__all__ = ["Ahead", "DelayedActions", "Model", "Simulator", "plant", "record", "state_of"]
