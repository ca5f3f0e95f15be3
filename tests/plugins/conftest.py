"""Foreign packages are no modules of ours: nothing collects docstring examples from them."""

collect_ignore_glob = ["lab/*", "own_world/*", "helical_law/*"]
