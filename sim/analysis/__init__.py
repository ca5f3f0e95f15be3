"""The closed loop as a linear sampled system along a path: margins, responses, a regulator to start gains from."""
