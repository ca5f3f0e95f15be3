"""What a run leaves behind: folder, figures of merit, picture."""
