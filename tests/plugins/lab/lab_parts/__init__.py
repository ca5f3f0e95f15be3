"""Parts of a lab: a world, a law, a command, a path reader, a kind of sensors and a study."""
