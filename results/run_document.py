"""The run document, `run.json` in the run folder: plan, provenance and status of a run."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Literal
from urllib.parse import quote

from pydantic import BaseModel, ConfigDict, FailFast, Field, ValidationError, field_validator

from robogauntlet.suites.episode import Condition, RenderProfile, SuccessRule
from robogauntlet.suites.ranges import StatedTiming
from robogauntlet.suites.schema import Suite
from robogauntlet.support.files import RefusedFile, read_regular, write_whole

RUN_FILE = "run.json"
STORE_FILE = "episodes.sqlite"
FORMAT: Literal[1] = 1
EVERYWHERE = ("robogauntlet", "ray", "numpy", "scipy", "torch")
"""Distributions that every run records beside its simulators'."""
RESULTS_OF_OTHERS = "results-of-others"
"""Kind of policies of which only the outcomes of trials are known, as other programs or people wrote them down."""
MAX_COUNT = 2**53
"""Largest integer of a document: JSON, JavaScript and databases agree on all numbers up to it."""
LONGEST_REASON = 4_000
"""Largest length of a message in a document (characters); longer ones are shortened."""
LARGEST = 256 * 2**20
"""Largest size of a run document (bytes)."""
LONGEST_SUITE = 4_000_000
"""Largest length of a suite, as its text and as JSON (characters)."""
Count = Annotated[int, Field(ge=0, le=MAX_COUNT)]
LATEST = 7_258_118_400
"""The year 2200, in seconds since 1970, UTC."""
Time = Annotated[float, Field(ge=0, le=LATEST, allow_inf_nan=False)]
"""Seconds since 1970, UTC, up to `LATEST`."""
Duration = Annotated[float, Field(ge=0, le=1e10, allow_inf_nan=False)]
"""Seconds."""


class RunStatus(StrEnum):
    """The status of a run."""

    RUNNING = "running"
    COMPLETE = "complete"
    """Every planned episode has a row."""
    INTERRUPTED = "interrupted"
    """By Ctrl-C or a signal; the same command continues the run."""
    STOPPED = "stopped"
    """Ended early by itself; see `reason`."""


class RunError(Exception):
    """A folder that is not a run folder, or not that of the expected run."""


class _Model(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", str_max_length=500)


Text = Annotated[str, Field(max_length=2 * LONGEST_REASON)]


class PlannedCell(_Model):
    """A cell of the plan: one policy on one task under one condition."""

    simulator: str
    task: str
    policy: str
    policy_digest: str
    axis: str
    severity: Count
    planned: Count
    """Episodes (seeds) planned."""

    @property
    def condition(self) -> Condition:
        """The cell's condition."""
        return Condition(self.axis, self.severity)


class Unsupported(_Model):
    """An axis that a task of the plan does not support, so that no episode of both is planned."""

    axis: str
    task: str
    reason: Text


class Decided(_Model):
    """A comparison under one condition that was decided early."""

    policy: str
    """The policy that is compared with the suite's baseline policy."""
    axis: str
    severity: Count
    pairs: Count
    seeds: Count
    """Seeds per task when it was decided."""
    evidence: Annotated[float, Field(ge=0)]
    """E-value."""


class EnvironmentRecord(_Model):
    """A Python environment other than the run's own, in which a simulator ran."""

    name: str
    hash: str
    """Hash of its definition in the suite, the user's configuration or the adapter."""
    python: str
    inherits: bool
    """Whether the run's own packages are visible behind the environment's."""
    packages: dict[str, str]
    """Distribution to installed version: the simulator's, and the required ones."""


class Provenance(_Model):
    """Software and hardware of the run."""

    git_commit: str | None = None
    git_dirty: bool | None = None
    """Whether the working tree had uncommitted changes."""
    python: str = ""
    platform: str = ""
    processor: str = ""
    cores: Count = 0
    packages: dict[str, str] = Field(default_factory=dict)
    """Distribution to version."""
    environments: dict[str, EnvironmentRecord] = Field(default_factory=dict)
    """Simulator to its environment, if it was not the run's own."""
    definitions: dict[str, str] = Field(default_factory=dict)
    """Task to the hash of the file that defines it, in runs of mappings that were files; else empty."""

    @property
    def versions(self) -> dict[str, str]:
        """Every version: `packages`, those of environments as `simulator: distribution`, and `definitions`."""
        apart = {
            f"{simulator}: {name}": version
            for simulator, one in self.environments.items()
            for name, version in one.packages.items()
        }
        return {**self.packages, **apart, **self.definitions}


class RunArguments(_Model):
    """What `robogauntlet run` was given, for `robogauntlet resume`: a part of the suite file, and how to play it."""

    policies: tuple[Text, ...] = ()
    options: tuple[Text, ...] = ()
    """Options of policies, `NAME=VALUE`."""
    tasks: tuple[Text, ...] = ()
    seeds: Count | None = None
    success: SuccessRule | None = None
    timing: StatedTiming = None
    image_size: Count | None = None
    replan_every: Count | None = None
    render_profile: RenderProfile | None = None
    workers: Count | str | None = None
    require: tuple[str, ...] = ()
    address: str | None = None
    history: Text | None = None
    """URL of the history (password hidden)."""
    retry_errors: bool = False
    media: bool | None = None
    tracker: str | None = None
    project: str | None = None
    """Of the tracker."""


class RunDocument(_Model):
    """The content of `run.json`."""

    format: Literal[1] = FORMAT
    run_id: str
    suite: Suite
    """The suite, reduced to the selected part."""
    suite_hash: str
    """Hash of the planned episodes; equal for suites that plan the same ones."""
    suite_text: Annotated[str, Field(max_length=LONGEST_SUITE)]
    """The text of the suite file."""
    suite_path: Annotated[str, Field(max_length=4096)]
    store_url: Text | None = None
    """URL of the store (password hidden), or None for the file in the run folder."""
    origin: Literal["local", "imported"] = "local"
    """Whether the run was played here or came as an exported run, which is rows and nothing to play."""
    started_at: Time
    """Start of the first session (seconds since 1970, UTC)."""
    finished_at: Time | None = None
    """End of the last session."""
    elapsed_s: Duration = 0.0
    """Time until the last episode had ended, over all sessions (s)."""
    media_s: Duration = 0.0
    """Time spent afterwards on videos and snapshots, over all sessions (s)."""
    media_left_out: Count = 0
    """Videos and snapshots that were not recorded, for lack of time or because of an error."""
    command: Annotated[str, Field(max_length=LONGEST_SUITE)] | None = None
    """The command that continues the run."""
    arguments: RunArguments | None = None
    """None if another command than `run` began it."""
    status: RunStatus = RunStatus.RUNNING
    reason: Text | None = None
    plan: Annotated[tuple[PlannedCell, ...], FailFast()]
    unsupported: tuple[Unsupported, ...] = ()
    tasks_left_out: tuple[Text, ...] = ()
    """Tasks of the suite in which a policy that was added to it cannot act."""
    warnings: tuple[Text, ...] = ()
    """What a reader of the numbers must know of how its policies were played, a sentence each."""
    server_metadata: dict[str, Text] = Field(default_factory=dict)
    """Policy with an identity to the hash of what its server says of itself."""
    instructions: dict[str, Text] = Field(default_factory=dict)
    """Task to its instruction."""
    robots: dict[str, Text] = Field(default_factory=dict)
    """Task to its robot, of tasks that several robots can play."""
    decided: tuple[Decided, ...] = ()
    workers: dict[str, Count] = Field(default_factory=dict)
    """Simulator to its number of workers in the last session; empty if all simulators shared `shared_workers`."""
    shared_workers: Count | None = None
    inference: str = "worker"
    """Place of inference of policies that use images in the last session: "worker" or "served"."""
    skipped: dict[str, Text] = Field(default_factory=dict)
    """Simulator to the reason why it could not run here."""
    render_devices: dict[str, str] = Field(default_factory=dict)
    """Simulator to its render device."""
    rows_hash: str | None = None
    """Hash of all stored rows without telemetry."""
    provenance: Provenance = Provenance()

    @field_validator("suite")
    @classmethod
    def _suite_of_moderate_size(cls, suite: Suite) -> Suite:
        if (length := len(suite.model_dump_json())) > LONGEST_SUITE:
            raise ValueError(f"expected at most {LONGEST_SUITE:,} characters, got {length:,}")
        return suite

    @field_validator("plan")
    @classmethod
    def _countable_plan(cls, plan: tuple[PlannedCell, ...]) -> tuple[PlannedCell, ...]:
        if (planned := sum(cell.planned for cell in plan)) > MAX_COUNT:
            raise ValueError(f"expected at most {MAX_COUNT} planned episodes, got {planned}")
        return plan

    @property
    def is_outcomes_only(self) -> bool:
        """Whether nothing but outcomes is known, see `RESULTS_OF_OTHERS`."""
        return any(policy.kind == RESULTS_OF_OTHERS for policy in self.suite.policies)

    @property
    def planned(self) -> int:
        """Episodes planned, skipped simulators included."""
        return sum(cell.planned for cell in self.plan)


def read_run(folder: Path) -> RunDocument:
    """Read the document of a run folder.

    Raises:
        RunError: The folder is not a run folder, or its document has another format.
    """
    path = folder / RUN_FILE
    if not folder.is_dir():
        raise RunError(
            f"{folder}: expected a run folder, {'this is a file' if folder.exists() else 'it does not exist'}"
        )
    try:
        text = read_regular(path, LARGEST).decode()
    except FileNotFoundError:
        raise RunError(f"{folder}: expected a run folder, it has no {RUN_FILE}") from None
    except RefusedFile as error:
        raise RunError(f"{path}: expected a run document, got {error}") from None
    except (OSError, UnicodeDecodeError) as error:
        raise RunError(f"{path}: cannot be read: {error}") from None
    return parse_run(text, str(path))


def parse_run(text: str, where: str) -> RunDocument:
    """Parse the JSON of a document; `where` names its source in messages.

    Raises:
        RunError: It is not a run document of format `FORMAT`.
    """
    try:
        return RunDocument.model_validate_json(text)
    except ValidationError as error:
        first = error.errors(include_url=False, include_context=False, include_input=False)[0]
        place = ascii(".".join(map(str, first["loc"])))[1:-1][:100] or "the file"  # names in it may be hostile
        raise RunError(
            f"{where}: expected a run document of format {FORMAT}, got another one ({place}: {first['msg']}); "
            "read it with the RoboGauntlet that wrote it, or run the suite again"
        ) from None


def refuse_imported(folder: Path, document: RunDocument, use: str) -> None:
    """Refuse a use of an imported run, such as "continued". Raises RunError."""
    if document.origin == "imported":
        raise RunError(f"{folder}: an imported run is not {use}; run its suite file: robogauntlet run SUITE")


def shortened(message: str) -> str:
    """Return a message as documents hold it: of at most `LONGEST_REASON` characters."""
    return message if len(message) <= LONGEST_REASON else f"{message[: LONGEST_REASON - 4]} ..."


def write_run(folder: Path, document: RunDocument) -> None:
    """Replace `run.json` atomically. Raises OSError."""
    write_whole(folder / RUN_FILE, document.model_dump_json(indent=1) + "\n")


def store_url(folder: Path, document: RunDocument, url: str | None = None) -> str:
    """Return the URL of a run's store: `url`, or the file in the run folder.

    Raises:
        RunError: The rows are in a database, whose URL with its password has to be given.
    """
    if url is not None:
        return url
    if document.store_url is not None:
        raise RunError(f"{folder}: its rows are in {document.store_url}; give that address with --store")
    return f"sqlite:///{quote(str(folder / STORE_FILE))}"
