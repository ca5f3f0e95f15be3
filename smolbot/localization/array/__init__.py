"""The sensors themselves as unknowns of a fit."""
