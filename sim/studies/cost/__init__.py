"""What accuracy costs in time: `cost` sweeps the knobs of a scene, `compare` a few values of one setting.

`report` has what both write, as types; their JSON schema is made of these.
"""
