"""True fields of coils and magnet, the oscillating cantilever, and the sensors' readings."""
