"""Contact of cloth with obstacles: where obstacles are, what touches, and the responses."""
