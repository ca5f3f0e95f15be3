"""What a run leaves: its folder, record, summary, pictures and report."""
