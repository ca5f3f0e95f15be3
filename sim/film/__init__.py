"""The tank's camera: top-view videos of a simulated run, and high-speed clips of an oscillating cantilever."""
