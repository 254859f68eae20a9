"""How a suite is run: what each simulator's workers need, and where policies compute. No part of what is evaluated."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

Positive = Annotated[float, Field(gt=0, le=10_000)]


class Resources(BaseModel):
    """What a worker of a simulator needs. Ray starts it where there is so much."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    num_cpus: Positive = 1.0
    num_gpus: Annotated[float, Field(ge=0, le=64)] = 0.0
    """Share of a GPU; 0.25 lets four workers share one."""
    memory_gb: Positive | None = None
    """GiB that a worker may come to hold: reserved for it, and the worker is replaced when it holds more."""

    @property
    def memory_bytes(self) -> int | None:
        """`memory_gb` in bytes."""
        return None if self.memory_gb is None else int(self.memory_gb * 1024**3)

    def ray_options(self) -> dict[str, float]:
        """As options of a Ray actor."""
        asked: dict[str, float] = {"num_cpus": self.num_cpus, "num_gpus": self.num_gpus}
        return asked | ({} if self.memory_bytes is None else {"memory": self.memory_bytes})


class Inference(BaseModel):
    """Where policies that look at images compute."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    place: Literal["worker", "served", "auto"] = "worker"
    """In each worker; or in processes of their own that answer the workers' queries in batches; or wherever a query is
    answered sooner, measured before the run."""
    batch: Annotated[int, Field(strict=True, ge=1, le=1024)] = 16
    """Queries answered at once, at most. With 1 a served policy acts to the bit as in a worker on the same device."""
    wait_ms: Annotated[float, Field(ge=0, le=10_000)] = 2.0
    """For how long a query waits for others, at most."""
    replicas: Annotated[int, Field(strict=True, ge=1, le=256)] = 1
    """Serving processes; a worker always asks the same one."""
    num_gpus: Annotated[float, Field(ge=0, le=64)] = 0.0
    """Share of a GPU for each of them."""

    @model_validator(mode="before")
    @classmethod
    def _shorthand(cls, value: Any) -> Any:
        return {"place": value} if isinstance(value, str) else value
