"""Household tasks as the environments of reinforcement-learning libraries.

| library | what it takes |
|---|---|
| Gymnasium | `gymnasium.make("reel/Household-v0", tasks=...)`, `HouseholdEnv`, `HouseholdVectorEnv` |
| TRL | `GRPOTrainer(environment_factory=household_factory(...))` |
| verifiers | `load_environment(...)`, taskset `reel-household` |
| ms-swift | `--external_plugins $(python -m reel.envs.swift) --gym_env reel_household` |

Importing this module imports none of them but Gymnasium, where it is installed, to register
`reel/Household-v0`. All of them record episodes as traces, start from any call of a recorded episode,
and answer whatever a model says.
"""

from __future__ import annotations

import importlib
import importlib.util
from typing import TYPE_CHECKING, Any

from ._episodes import clear_cache
from ._extras import MissingPackageError

if TYPE_CHECKING:
    from .gymnasium import HouseholdEnv
    from .swift import HouseholdGym
    from .trl import HouseholdTools, household_dataset, household_factory, success_reward
    from .vector import HouseholdVectorEnv
    from .verifiers import load_environment

ENV_ID = "reel/Household-v0"
"""Id of the Gymnasium environment."""

_MODULES = {
    "HouseholdEnv": "gymnasium",
    "HouseholdGym": "swift",
    "HouseholdTools": "trl",
    "HouseholdVectorEnv": "vector",
    "household_dataset": "trl",
    "household_factory": "trl",
    "load_environment": "verifiers",
    "success_reward": "trl",
}


def register() -> None:
    """Registers `reel/Household-v0` with Gymnasium; importing `reel.envs` does it."""
    import gymnasium

    if ENV_ID not in gymnasium.registry:
        gymnasium.register(  # pyright: ignore[reportUnknownMemberType]
            ENV_ID,
            entry_point="reel.envs.gymnasium:HouseholdEnv",
            vector_entry_point="reel.envs.vector:HouseholdVectorEnv",
        )


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_MODULES[name]}"), name)


def __dir__() -> list[str]:
    return sorted(__all__)


if importlib.util.find_spec("gymnasium") is not None:
    register()

__all__ = [
    "ENV_ID",
    "HouseholdEnv",
    "HouseholdGym",
    "HouseholdTools",
    "HouseholdVectorEnv",
    "MissingPackageError",
    "clear_cache",
    "household_dataset",
    "household_factory",
    "load_environment",
    "register",
    "success_reward",
]
