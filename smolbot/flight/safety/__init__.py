"""What ends a run before harm is done."""
