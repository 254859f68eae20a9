"""The environment variables that are secret, and those that processes get which run the code of policies."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping

SERVER_SECRETS = (
    "ROBOGAUNTLET_TOKEN",
    "ROBOGAUNTLET_SMTP_USER",
    "ROBOGAUNTLET_SMTP_PASSWORD",
    "ROBOGAUNTLET_WEBHOOK_URL",
)
"""Secrets of the dashboard, of policy servers and of notifications."""
RUN_SECRETS = (
    *("ROBOGAUNTLET_STORE", "ROBOGAUNTLET_HISTORY", "PGPASSWORD", "WANDB_API_KEY"),
    *(f"MLFLOW_TRACKING_{name}" for name in ("URI", "USERNAME", "PASSWORD", "TOKEN")),
)
"""Secrets that a run's own process needs: URLs of databases, which may hold passwords, and experiment trackers."""
SECRETS = (*SERVER_SECRETS, *RUN_SECRETS)
"""All but the tokens of policies."""
POLICY_TOKEN = "ROBOGAUNTLET_POLICY_TOKEN"
"""The token of a policy server; with a suffix, of one of several. Workers have them, since they query the servers."""
VARIABLES = "ROBOGAUNTLET_VARIABLES"
"""Names of further variables that every process gets, such as those of one's own simulator."""
_NAMES = """
    PATH HOME USER LOGNAME SHELL PWD TERM COLORTERM NO_COLOR FORCE_COLOR COLUMNS LINES TZ LANG LANGUAGE LOCPATH HOSTNAME
    TMPDIR TMP TEMP VIRTUAL_ENV DISPLAY WAYLAND_DISPLAY XAUTHORITY DRI_PRIME CI SSL_CERT_FILE SSL_CERT_DIR
    REQUESTS_CA_BUNDLE CURL_CA_BUNDLE RAY_AUTH_TOKEN HTTP_PROXY HTTPS_PROXY ALL_PROXY FTP_PROXY NO_PROXY
"""
_PREFIXES = """
    ROBOGAUNTLET_ PYTHON PYENV_ CONDA_ MAMBA_ PIP_ UV_ NIX_ LC_ LD_ XDG_ MALLOC_ GLIBC_ ASAN_ LSAN_ UBSAN_
    OMP_ GOMP_ KMP_ MKL_ OPENBLAS_ BLIS_ NUMEXPR_ VECLIB_ TBB_ NUMBA_
    CUDA_ CUDNN_ CUBLAS_ NVIDIA_ NCCL_ NV_ HIP_ HSA_ ROCM_ ROCR_ GPU_ XLA_ JAX_ TF_ TORCH PYTORCH_ TRITON_
    MUJOCO_ PYOPENGL_ EGL_ __EGL_ __GLX_ __GL_ __NV_ __VK_ GLVND_ MESA_ LIBGL_ GALLIUM_ LP_ VK_
    SAPIEN_ MS_ MANISKILL_ LIBERO_ ROBOSUITE_ PYBULLET_ METAWORLD_ LEROBOT_
    OPENCV_ QT_ PYGLET_ NPY_ ONEDNN_ DNNL_ FONTCONFIG_ ACCELERATE_ APPTAINER_ SINGULARITY_
    HF_ HUGGINGFACE_ TRANSFORMERS_ TOKENIZERS_ DIFFUSERS_ DATASETS_ IMAGEIO_ FFMPEG_ SDL_ MPL
    RAY_ GRPC_ GLOG_ SLURM_ PBS_ LSB_ SGE_ OMPI_ PMI_ PMIX_ KUBERNETES_ PYTEST_ COVERAGE_ COV_
"""
"""What the system, Python, GPUs, renderers, simulators, Ray and job schedulers read. All else stays in the command's
own process: a list of what is secret would lack the next one."""
_SECRET_WORDS = """
    TOKEN TOKENS KEY KEYS APIKEY SECRET SECRETS PASSWORD PASSWD PASSPHRASE PASS PAT CREDENTIAL CREDENTIALS USERNAME JWT
    COOKIE JOBCOOKIE
"""
_SECRET_PREFIXES = ("NIX_CONFIG", "TF_VAR_")
"""Of variables that have a known prefix and hold tokens of code hosts, and Terraform's variables."""
_INHERITED, _INHERITED_PREFIXES = frozenset(_NAMES.split()), tuple(_PREFIXES.split())
_SECRET = frozenset(_SECRET_WORDS.split())
_LOGIN = re.compile(r"://\S*@")
"""A login in an address, such as that of a package index."""


def without_secrets(environment: Mapping[str, str], *, but: Collection[str] = ()) -> dict[str, str]:
    """Return the variables for a process that needs no secret: those that are known to be none, and `but` these.

    Those that `VARIABLES` names are among them.
    """
    further = {*but, *environment.get(VARIABLES, "").replace(",", " ").split()}
    return {name: value for name, value in environment.items() if name in further or _is_inherited(name, value)}


def playing_variables(environment: Mapping[str, str]) -> dict[str, str]:
    """Return the variables for a process that plays policies: as `without_secrets`, and the tokens of their servers."""
    return without_secrets(environment, but=[name for name in environment if is_policy_token(name)])


def _is_inherited(name: str, value: str) -> bool:
    upper = name.upper()
    if name in _INHERITED or upper.endswith("_PROXY"):
        return True
    is_known = name.startswith(_INHERITED_PREFIXES) and not upper.startswith(_SECRET_PREFIXES)
    return is_known and not (
        name in SECRETS or is_policy_token(name) or _SECRET & set(upper.split("_")) or _LOGIN.search(value)
    )


def is_policy_token(name: str) -> bool:
    """Whether a variable is the token of a policy server."""
    return name == POLICY_TOKEN or name.startswith(f"{POLICY_TOKEN}_")


def variable_names(value: object) -> tuple[str, ...]:
    """Return the option `variables` of a policy: the names of the variables that it needs. Raises ValueError."""
    names = [value] if isinstance(value, str) else value
    if not isinstance(names, list | tuple) or not all(
        isinstance(name, str) and re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]{0,99}", name) for name in names
    ):
        raise ValueError(f"expected names of environment variables, such as [HF_TOKEN], got {value!r}")
    return tuple(names)
