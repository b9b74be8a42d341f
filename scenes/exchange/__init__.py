"""Scenes in the files of other renderers: what a scene is in words that any of them knows, and a module a format.

`neutral` is the contract: a scene's own units and names, as JSON. The other formats are made from what it says.
"""
