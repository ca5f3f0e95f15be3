"""The command line. Heavy imports live inside the functions that need them."""
