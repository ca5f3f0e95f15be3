"""What holds a device and moves it: a liquid, a gel, a hand."""
