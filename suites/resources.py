"""Resources of workers and place of inference. They do not affect the identity of episodes."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

Positive = Annotated[float, Field(ge=0.001, le=10_000)]
"""From a thousandth on, as fine as Ray counts."""


class Resources(BaseModel):
    """Resources that Ray reserves for a worker of a simulator."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    num_cpus: Positive = 1.0
    num_gpus: Annotated[float, Field(ge=0, le=64)] = 0.0
    """Share of a GPU; 0.25 lets four workers share one."""
    memory_gb: Positive | None = None
    """GiB that are reserved for a worker, which is replaced if it uses more."""

    @property
    def memory_bytes(self) -> int | None:
        """`memory_gb` in bytes."""
        return None if self.memory_gb is None else int(self.memory_gb * 1024**3)

    def ray_options(self) -> dict[str, float]:
        """Return the options of a Ray actor."""
        options: dict[str, float | None]
        options = {"num_cpus": self.num_cpus, "num_gpus": self.num_gpus, "memory": self.memory_bytes}
        return {name: value for name, value in options.items() if value is not None}


class Inference(BaseModel):
    """Place of inference of policies that use images."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    place: Literal["worker", "served", "auto"] = "worker"
    """In each worker, or in separate processes that answer the workers' queries in batches; auto: the faster of both,
    measured before the run."""
    batch: Annotated[int, Field(strict=True, ge=1, le=1024)] = 16
    """Maximum batch size. With 1, actions are bit-identical to those in a worker on the same device."""
    wait_ms: Annotated[float, Field(ge=0, le=10_000)] = 2.0
    """Maximum time that a query waits for others."""
    replicas: Annotated[int, Field(strict=True, ge=1, le=256)] = 1
    """Inference processes; a worker always uses the same one."""
    num_gpus: Annotated[float, Field(ge=0, le=64)] = 0.0
    """Share of a GPU for each of them."""

    @model_validator(mode="before")
    @classmethod
    def _shorthand(cls, value: Any) -> Any:
        return {"place": value} if isinstance(value, str) else value
