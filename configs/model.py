"""The base class of all models of the configuration."""

from pydantic import BaseModel, ConfigDict


class Model(BaseModel):
    """A mapping of keys: an unknown key, NaN and infinity are refused, and nothing changes once it is validated."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)
