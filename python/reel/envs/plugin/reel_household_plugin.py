"""The plug-in for ms-swift's `--external_plugins`: registers the environment `reel_household`."""

from reel.envs.swift import register

register()
