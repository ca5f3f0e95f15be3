"""Parts of a lab: a world, a law, an estimator, a command, a path reader, a kind of sensors and a study."""
