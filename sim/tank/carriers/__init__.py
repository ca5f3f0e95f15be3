"""Carriers that hold and move a device: a liquid, a gel, an operator."""
