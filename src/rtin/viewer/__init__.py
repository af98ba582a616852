"""Terrain to look at: a live page in the browser, pictures and films, notebooks."""
