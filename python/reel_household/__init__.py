"""The taskset `reel-household` of verifiers, which finds tasksets as modules by their ids."""

from reel.envs.verifiers import HouseholdHarness, HouseholdTaskset, HouseholdVerifiersEnv, load_environment

__all__ = ["HouseholdHarness", "HouseholdTaskset", "HouseholdVerifiersEnv", "load_environment"]
