"""Supervision that ends a run before harm is done."""
