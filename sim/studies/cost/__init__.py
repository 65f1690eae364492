"""What accuracy costs in time: `cost` sweeps the knobs of one scene, `compare` sets a few values side by side.

`report` has what both write, as types; their JSON schema is made of these.
"""
