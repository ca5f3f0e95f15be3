"""The closed loop as a linear sampled system along a path: margins, responses, and a regulator to start gains from."""
