"""The service: a registry of plants, episodes, artifacts, decisions and what serves, over HTTP."""
